"""The commands: each file here is one, named as it is; all are loaded (`import_` is `fpplab import`)."""
