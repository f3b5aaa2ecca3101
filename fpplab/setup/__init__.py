"""Setting a rig up: writing its file, checking it, watching it live, and guiding a characterisation."""
