"""Commands of the twin and of its applications, which entry points of the group `fpplab.commands` announce.

Heavy modules are imported where they are used, so that `--help` answers at once.
"""
