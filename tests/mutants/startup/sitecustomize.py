"""Records which lines a process executes: Python runs this wherever the folder is on its path."""

import coverage

coverage.process_startup()
