"""The program with every command: for its help, its shell completion and a word that names no command."""

from importlib import import_module
from pkgutil import iter_modules

from fpplab.cli import commands
from fpplab.cli.app import TWIN, app, arrange_commands, is_single_command
from fpplab.core import plugins

for _module in iter_modules(commands.__path__):
    import_module(f"{commands.__name__}.{_module.name}")
for _name in plugins.plugin_names(plugins.COMMANDS):
    _program = plugins.load_plugin(plugins.COMMANDS, _name)
    if is_single_command(_program):
        app.registered_commands.extend(_program.registered_commands)
    else:
        app.add_typer(_program, name=_name, rich_help_panel=_program.rich_help_panel or TWIN)
arrange_commands()

__all__ = ["app"]
