"""Many scans and reconnections in one process: handles, threads and memory stay as they are."""
