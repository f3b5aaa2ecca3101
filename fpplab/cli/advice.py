"""What to say of a command or an option that does not exist: the one that was probably meant."""

from collections.abc import Mapping, Sequence
from difflib import get_close_matches

_MEANT = {
    ("artefact",): "artifact shape stl mesh truth",
    ("bug-report",): "bug bugreport bug_report support issue problem crash",
    ("session",): "sessions info repair fsck recover rescue damaged",
    ("cache",): "clear clean purge",
    ("characterise",): "calibrate calibration calib characterize characterization characterisation poses",
    ("check",): "sync synchronise synchronize synchronisation synchronization diagnose test",
    ("compare",): "evaluate evaluation align alignment register registration icp accuracy error distance",
    ("compare-rigs",): "cross crossing confront compare_rigs",
    ("convert",): "opencv exchange",
    ("dataset",): "data-set train training generate",
    ("decode",): "unwrap unwrapping phase demodulate decoding",
    ("demo", "scan"): "simulate simulation sim virtual",
    ("demo",): "example tutorial start quickstart try",
    ("devices",): "list detect discover cameras projectors hardware ports",
    ("doctor",): "install installation environment versions",
    ("export", "reconstruct"): "save",
    ("export",): "e57 las laz obj stl 3mf csv matlab ros slstudio",
    ("emulate",): "emulator emulators emulation",
    ("gamma",): "response linearise linearize linearity nonlinearity",
    ("import",): "load read open ingest",
    ("live",): "setup set-up preview focus",
    ("match",): "digital-twin fit",
    ("optimise",): "optimize optimisation optimization search tune",
    ("plan",): "plans pattern patterns fringe fringes project",
    ("reconstruct",): "triangulate triangulation cloud pointcloud point-cloud points reconstruction 3d",
    ("rig",): "configure setup latency settle refresh",
    ("scan",): "measure measurement acquire acquisition capture record recording grab run shoot",
    ("target",): "board boards checkerboard chessboard charuco print",
    ("verify",): "acceptance certify vdi validate verification",
    ("view",): "show display viewer visualise visualize plot see",
}
SYNONYMS = {word: commands for commands, words in _MEANT.items() for word in words.split()}
"""The commands that may be meant by a word that is none."""

_OPTIONS_MEANT = {
    ("--align",): "--aligned --register --registration --icp",
    ("--bits",): "--bit-depth --depth-bits",
    ("--calibration",): "--calib --cal -c --calibration-file",
    ("--count", "--poses", "--repeats"): "--number --num -n --samples",
    ("--depth",): "--distance --range --depth-range --depth-mm",
    ("--force",): "--overwrite --replace --yes -f -y",
    ("--frames",): "--names --filenames --images",
    ("--item",): "--object --artefact --artifact --part",
    ("--model",): "--distortion",
    ("--out",): "--output --outfile --output-file --output-dir --save --to -o",
    ("--plan",): "--pattern --patterns --fringes -p",
    ("--rig",): "--bench --setup --config -r",
    ("--target",): "--board --checkerboard -t",
    ("--view",): "--show --watch --live",
    ("--workers",): "--jobs --threads --processes -j",
}
OPTION_SYNONYMS = {word: options for options, words in _OPTIONS_MEANT.items() for word in words.split()}
"""The options that may be meant by one that a command has not; the first that it has is named."""


OPTION_HINTS = {
    "--calibration": "`fpplab characterise` makes one",
    "--item": "what the rig's fixture is to put up, such as pyramid",
    "--out": "name what is to be written",
    "--rig": "name a rig file; rig_demo_quick is simulated, and `fpplab rig new` writes one for a bench",
    "--target": "name the board's file; `fpplab target` draws a board and writes it",
}
"""Where the value of an option comes from that a command cannot do without."""


FIELDS = {
    **dict.fromkeys(("--exposure", "--exposure-s", "--exposure-time"), "exposure_s of the plan"),
    **dict.fromkeys(("--exposures", "--exposures-s"), "exposures_s of the plan"),
    **{f"--{name}": f"{name} of the plan" for name in ("fringes", "masks", "response", "steps", "stripes")},
    **{f"--{name}": f"{name} of the rig file" for name in ("camera", "projector", "stage", "serial", "port")},
    **dict.fromkeys(("--gain", "--gain-db"), "gain_db of the camera in the rig file"),
}
"""Words that are no options since a file says them, and which."""


def missing_option(path: str, option: str, purpose: str = "") -> str:
    if option in OPTION_HINTS or not purpose:
        return f"`{path}` needs {option}; {OPTION_HINTS.get(option, f'see `{path} --help`')}"
    return f"`{path}` needs {option}: {purpose}"


def unknown_command(path: str, word: str, purposes: Mapping[str, str]) -> str:
    # `purposes` has the first sentence of each command's help, by the command's name.
    reason = f"there is no command '{' '.join([*path.split()[1:], word])}'"
    lower = word.lower()
    if lower in ("help", "version"):
        return f"{reason}; say `{path} --{lower}`"
    synonyms = SYNONYMS.get(lower, ())
    if synonyms and all(command in purposes for command in synonyms):
        meant = ", or ".join(f"`{path} {command}` ({purposes[command].rstrip('.')})" for command in synonyms)
        return f"{reason}; did you mean {meant}?"
    usable = {
        name: commands_meant
        for name, commands_meant in SYNONYMS.items()
        if all(meant_command in purposes for meant_command in commands_meant)
    }
    closest = closest_name(lower, [*purposes, *usable])
    if closest is None:
        return f"{reason}; `{path} --help` lists those that there are"
    return f"{reason}; did you mean `{path} {usable.get(closest, (closest,))[0]}`?"


def unknown_option(path: str, word: str, options: Sequence[str]) -> str:
    reason = f"`{path}` has no option {word}"
    for option in OPTION_SYNONYMS.get(word, ()):
        if option in options:
            return f"{reason}; it is {option}"
    if word in FIELDS:
        return f"{reason}; it is {FIELDS[word]}"
    closest = closest_name(word, [option for option in options if option.startswith("--")])
    return f"{reason}; " + (f"did you mean {closest}?" if closest else f"see `{path} --help`")


def closest_name(word: str, names: Sequence[str]) -> str | None:
    begun = [name for name in names if len(word) > 2 and name.startswith(word)]
    return next(iter(begun or get_close_matches(word, names, n=1)), None)
