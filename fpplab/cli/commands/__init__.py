"""The commands: each file defines the command of its name; all are loaded (`import_` is `fpplab import`)."""
