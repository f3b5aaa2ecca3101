"""The command line: every file of `fpplab.cli.commands` is a command; drivers and twin bring their own.

Heavy modules are imported where they are used, so that `--help` is at once.
"""

import sys
from functools import partial
from importlib import import_module
from pkgutil import iter_modules

from fpplab.cli import commands, console
from fpplab.cli.app import TWIN, app, arrange_commands, is_single_command
from fpplab.core import plugins

for _module in iter_modules(commands.__path__):
    import_module(f"{commands.__name__}.{_module.name}")
for _name in plugins.plugin_names(plugins.COMMANDS):
    _program = plugins.load_plugin(plugins.COMMANDS, _name)
    if is_single_command(_program):
        app.registered_commands.extend(_program.registered_commands)
    else:
        app.add_typer(_program, name=_name, rich_help_panel=TWIN)
arrange_commands()


def main() -> None:
    """Run the command that `sys.argv` names and leave with its exit code."""
    console.run_program(partial(app, prog_name="fpplab"), as_json="--json" in sys.argv)


__all__ = ["app", "main"]
