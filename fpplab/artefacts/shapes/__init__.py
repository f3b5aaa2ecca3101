"""The artefacts and standards: one subclass of `Artefact` per file, whose name is the artefact's name."""
