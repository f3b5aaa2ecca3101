"""What to say of words that do not fit a command: one sentence, with what to write instead."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from fpplab.cli.advice import closest_name, missing_option, unknown_option
from fpplab.core.config import shipped_configs
from fpplab.core.file_kinds import (
    CALIBRATION,
    DATASET,
    LIMITS,
    PLAN_FILE,
    RESPONSE,
    RIG,
    SESSION,
    STANDARD,
    STL,
    STUDY,
    TARGET,
    describe_file,
)  # fmt: skip
from fpplab.core.units import MM, SECONDS, corrected_number

OPTIONS_OF_KIND = {
    CALIBRATION: ("--calibration",),
    DATASET: ("--scenes",),
    LIMITS: ("--limits",),
    PLAN_FILE: ("--plan",),
    RESPONSE: ("--gamma",),
    RIG: ("--rig", "--twin"),
    SESSION: ("--reference", "--spheres"),
    STANDARD: ("--standard",),
    STL: ("--mesh",),
    STUDY: ("--study",),
    TARGET: ("--target",),
}

_PAIR = re.compile(r"(\d+(?:[.,]\d+)?)\s*(?:mm|px)?\s*[x×,;:*/…-]\s*(\d+(?:[.,]\d+)?)\s*(?:mm|px)?")
_CHOICES = re.compile(r"'(.*?)' is not one of (.*)$", re.DOTALL)


def usage_sentence(error: Any, words: Sequence[str], context: Any) -> str | None:
    """Say what is wrong with the words behind a group of commands; None where the error is none of usage."""
    # The errors' classes are typer's or click's own, by their versions.
    if error.ctx is not None:
        path, params = error.ctx.command_path, error.ctx.command.get_params(error.ctx)
    else:  # of an option without its values
        command = getattr(context.command, "commands", {}).get(words[0] if words else "", context.command)
        path, params = f"{context.command_path} {words[0]}", command.get_params(context)
    param = getattr(error, "param", None)
    match type(error).__name__:
        case "NoSuchOption":
            name = error.option_name.lstrip("-")
            if argument := next((each for each in params if each.opts[0] in (name, f"{name}s")), None):
                return f"`{path}` takes {_metavar(argument)} without an option: {_purpose(argument)}"
            commands = getattr(error.ctx.command, "commands", {})
            for command in sorted(commands.values(), key=lambda command: command.name not in words):
                if any(error.option_name in each.opts for each in command.params):
                    place = f"behind its command, such as `{path} {command.name}`"
                    return f"`{path}` has no option {error.option_name}; it stands {place}"
            options = [name for each in params for name in (*each.opts, *each.secondary_opts)]
            return unknown_option(path, error.option_name, options)
        case "MissingParameter" if param is not None:
            name = param.opts[0]
            if not name.startswith("-"):
                return f"`{path}` needs {_metavar(param)}: {_purpose(param)}"
            if name in words:  # which the option before it has taken for its value
                return f"{words[words.index(name) - 1]} is followed by {name} instead of its value"
            return missing_or_misplaced(path, name, words[1:], _purpose(param))
        case "BadOptionUsage":
            param = next((each for each in params if error.option_name in each.opts), None)
            return None if param is None else _too_few_values(param, _values(words, error.option_name, 1))
        case "BadParameter" if param is not None:
            return _wrong_value(param, error, words)
        case "UsageError" if extra := re.search(r"unexpected extra argument\S* \((.*)\)", error.message):
            return _unexpected(path, extra[1], params, words)
        case "UsageError" | "BadArgumentUsage":
            return f"`{path}`: {error.message.rstrip('.')}; see `{path} --help`"
    return None


def _metavar(param: Any) -> str:
    return str(param.metavar or param.name.upper())


def _purpose(param: Any) -> str:
    text = str(getattr(param, "help", None) or "see --help").split(" [")[0].rstrip(".")
    return text[:1].lower() + text[1:]


def _values(words: Sequence[str], option: str, count: int) -> list[str]:
    """Give the words that follow an option, as far as they are no options themselves."""
    for i, word in enumerate(words):
        if word.startswith(f"{option}="):
            return [word.partition("=")[2]]
        if word == option:
            following = list(words[i + 1 : i + 1 + count])
            ends = [n for n, each in enumerate(following) if re.match(r"--?[A-Za-z]", each)]
            return following[: ends[0]] if ends else following
    return []


def _options_for(word: str) -> tuple[str, ...]:
    path = Path(word)
    if path.exists():
        return OPTIONS_OF_KIND.get(describe_file(path) or "", ())
    is_shipped = path.name.removesuffix(".yaml") in shipped_configs()
    return (f"--{path.name.split('_')[0]}",) if is_shipped else ()


def missing_or_misplaced(path: str, option: str, words: Sequence[str], purpose: str = "") -> str:
    if stray := _misplaced_word(words, option):
        return f"`{path}` needs {option}; write {option} {stray}"
    return missing_option(path, option, purpose)


def _misplaced_word(words: Sequence[str], option: str) -> str | None:
    free = [word for i, word in enumerate(words) if not word.startswith("-") and words[i - 1][:2] != "--"]
    for word in free:
        if option in _options_for(word):
            return word
        if option == "--out" and Path(word).suffix and not Path(word).exists():
            return word
    return None


def _unexpected(path: str, extra: str, params: Sequence[Any], words: Sequence[str]) -> str:
    word = extra.split()[0]
    options = {name for each in params for name in each.opts}
    if option := next((each for each in _options_for(word) if each in options), None):
        return f"`{path}`: '{word}' stands without its option; write {option} {word}"
    if word in (*MM, *SECONDS):
        return f"`{path}`: '{word}' is a unit; give the number alone, in the unit of `{path} --help`"
    if word.lower() in ("yes", "no", "true", "false", "on", "off", "0", "1"):
        return f"`{path}`: '{word}' is too much; the option before it takes no value"
    if "--out" in options and "--out" not in words and not Path(word).exists():
        return f"`{path}`: '{word}' stands without its option; write --out {word} if it is to be written"
    arguments = [_metavar(each) for each in params if not each.opts[0].startswith("-")]
    takes = f"takes {' '.join(arguments)} and options" if arguments else "takes options alone"
    return (
        f"`{path}` {takes}, and not '{extra}'; a name with blanks needs quotes, and a value its option, see "
        f"`{path} --help`"
    )


def _too_few_values(param: Any, given: Sequence[str]) -> str:
    option, count = param.opts[0], max(param.nargs, 1)
    names = param.metavar if count > 1 and param.metavar else "a value"
    if count > 1:
        names = f"{count} values, {param.metavar or 'WIDTH HEIGHT'}"
    sentence = f"{option} needs {names}"
    if count == 1:
        return f"{sentence}: {_purpose(param)}"
    if given and (pair := _PAIR.fullmatch(given[0])):
        return f"{sentence}, apart by a blank; write {option} {pair[1]} {pair[2]}"
    shown = f"only '{given[0]}' is given" if given else "none is given"
    return f"{sentence}, and {shown}: {_purpose(param)}"


def _wrong_value(param: Any, error: Any, words: Sequence[str]) -> str:
    option, message = max(param.opts, key=len), str(error.message)
    option = option if option.startswith("-") else _metavar(param)
    count = max(param.nargs, 1)
    values = next((given for name in param.opts if (given := _values(words, name, count))), [])
    if not values and hasattr(error.__cause__, "errors"):  # of an argument, which no option precedes
        values = [str(each["input"]) for each in error.__cause__.errors()]
    if (count > 1 and len(values) < count) or (values and _PAIR.fullmatch(values[0]) and count > 1):
        return _too_few_values(param, values)
    if choices := _CHOICES.search(message):
        names = re.findall(r"'([^']+)'", choices[2])
        closest = closest_name(choices[1].lower(), names)
        question = f"; did you mean {closest}?" if closest else ""
        question = next((f"; write {each} {choices[1]}" for each in _options_for(choices[1])), question)
        return f"{option} is '{choices[1]}': must be one of {', '.join(names)}{question}"
    unit = re.search(r"\bin (s|ms|mm|µm|px|Hz|degrees)\b", str(getattr(param, "help", "")))
    wrong = [value for value in values if not re.fullmatch(r"[-+]?[\d.]+(e[-+]?\d+)?", value)] or values
    rule = message.removeprefix("Value error, ").removeprefix("Input ").split(", unable")[0].rstrip(".")
    rule = rule.replace("should be", "must be")
    in_unit = f" in {unit[1]}" if unit and "number" in rule else ""
    corrected = [corrected_number(value, unit[1] if unit else "") for value in values]
    is_better = (
        all(corrected) and corrected != values and ("integer" not in rule or "." not in str(corrected))
    )
    advice = f"; write {' '.join(map(str, corrected))}" if is_better else ""
    return f"{option} is '{' '.join(wrong)}': {rule}{in_unit}{advice}"
