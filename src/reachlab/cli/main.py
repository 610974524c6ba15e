"""The command line: one verb, one function; flags are the fields of the dataclasses."""

from __future__ import annotations

import argparse
import contextlib
import gc
import io
import itertools
import os
import re
import sys
import warnings
from collections.abc import Sequence
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import Any, TextIO

import tyro
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from reachlab.cli.flags import STUDENT, Distil, Train
from reachlab.cli.short_help import short
from reachlab.cli.sweep_flags import Sweep
from reachlab.cli.verbs import VERBS, overview
from reachlab.envs.presets import CHOICES, of_other_tasks, preset
from reachlab.envs.uses import unused
from reachlab.learn.interrupts import EXIT_BASE, asked, end_at_once, end_if_deaf, hear, raise_on_termination
from reachlab.settings.config import DistilRunConfig, RunConfig
from reachlab.settings.extensions import extended, import_extension, import_installed, import_of_runs
from reachlab.settings.json_form import flatten, to_json
from reachlab.settings.validation import InputError, choose

DONE, WRONG_INPUT, NOT_FINITE, INTERRUPTED = 0, 2, 3, 130
"""Exit statuses."""

UNREAD = 141
"""Exit status where the reader of the results has gone, as in `reachlab list | head -1`: the one of SIGPIPE."""

MORE: dict[type, str] = {
    Train: "\n\nNo flag is needed. The first group is enough for most runs, with --reward and --total-steps; the other"
    " groups change the rules of the task, the physics and the training. In brackets: defaults. Flags without effect on"
    " the task, simulator, action and reward that are chosen are not shown.",
}
"""Added to the docstring in the help of some commands."""

NUMBERS = ConstructorRegistry()
"""How flags that are whole numbers are read."""

NO_NUMBERS = re.compile(
    r"Error parsing (--\S+): (?:no type matching|could not .* to) (.+?)(?: could .* from|:) (\[.*\]|'.*')\."
)
"""Flags whose words are no numbers, as tyro says it: the flag, what it takes, and what was given."""

MISSING = re.compile(r"Missing from (reachlab \S+): (\S+) (.+?)\.? \(required\)\.")
"""A command without a word that it needs."""

LISTS = re.compile(r"(--\S+): Could not (?:parse|find valid parse for) arguments:? \[(.*?)\]")
"""Tyro's message on a list that is none of numbers, or is written with commas."""


@NUMBERS.primitive_rule
def _whole_numbers(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[int] | None:
    """Whole numbers are written in any way that numbers are, as 1e6."""
    if info.type is not int:
        return None
    return PrimitiveConstructorSpec(1, "INT", _whole_number, lambda value: isinstance(value, int), lambda n: [str(n)])


def _whole_number(words: list[str]) -> int:
    with contextlib.suppress(ValueError):
        if (number := float(words[0])).is_integer():
            return int(number)
    raise ValueError(f"must be a whole number, got {words[0]!r}")


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit status of the command line; see `DONE`, `WRONG_INPUT`, `NOT_FINITE`, `INTERRUPTED`, `UNREAD`."""
    _open_closed_streams()
    raise_on_termination()
    if arguments is None:  # this process is the command's own
        end_if_deaf()
    try:
        try:
            return _run(list(sys.argv[1:] if arguments is None else arguments))
        finally:
            sys.stdout.flush()
            if arguments is None:
                end_at_once()
                # Else what is left is looked through as Python ends, for half a second after a training. OMPL lists
                # what is left then as lost.
                if "ompl" not in sys.modules:
                    gc.freeze()
    except ImportError:
        if not asked:
            raise
        _say("interrupted.")
        return EXIT_BASE + asked[0]
    except BrokenPipeError:
        _drop(sys.stdout)
        _drop(sys.stderr)
        return UNREAD


def _open_closed_streams() -> None:
    """Where a standard stream is closed, as by `>&-`, what is written to it is dropped; no file gets its number."""
    sys.stdin = sys.stdin or os.fdopen(os.open(os.devnull, os.O_RDONLY))
    sys.stdout = sys.stdout or os.fdopen(os.open(os.devnull, os.O_WRONLY), "w")
    sys.stderr = sys.stderr or os.fdopen(os.open(os.devnull, os.O_WRONLY), "w")
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # what its encoding lacks is written otherwise
            stream.reconfigure(errors="backslashreplace" if stream is sys.stderr else "replace")


def _say(sentence: object) -> None:
    """Write to the terminal, if it is still open."""
    try:
        print(f"reachlab: {sentence}", file=sys.stderr, flush=True)
    except OSError:
        _drop(sys.stderr)


def _drop(stream: TextIO) -> None:
    """Write to nothing from here on: what is buffered has no reader either, and must not fail again as Python ends."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _run(words: list[str]) -> int:
    """Exit status of a command.

    Raises:
        BrokenPipeError: nobody reads its output.
    """
    try:
        if not words or words[0] in ("-h", "--help"):
            print(overview())
            return DONE
        if words[0] == "--version":
            print(f"reachlab {version('reachlab')}")
            return DONE
        verb = VERBS[choose("command", words[0], VERBS)]
        verb.run(_parse(words[0], verb.flags, _imported(words[1:])))
    except InputError as error:
        _say(error)
        return WRONG_INPUT
    except BrokenPipeError:
        raise
    except OSError as error:
        _say(f"{error.filename or 'a file'} cannot be used: {error.strerror or error}.")
        return WRONG_INPUT
    except FloatingPointError as error:
        _say(error)
        return NOT_FINITE
    except KeyboardInterrupt as interruption:
        hear()
        _say(str(interruption) or "interrupted.")
        return vars(interruption).get("status", INTERRUPTED)
    return DONE


def _parse(verb: str, flags: type, words: list[str]) -> Any:
    """Flags of a verb; `--task` and the flags of `CHOICES` are read first and set the other defaults.

    Raises:
        InputError: a flag or value that is not allowed, in one sentence.
    """
    default: Any = tyro.MISSING_NONPROP
    if flags in (Train, Sweep):
        default = flags(run=_defaults(flags, _chosen(words)))
    elif flags is Distil and isinstance(config := _resumed(flags, _chosen(words)), DistilRunConfig):
        settings = flatten(to_json(config))
        default = Distil(**{name: settings[name] for name in STUDENT if name in settings}, settings=config.dagger)
    marks = [tyro.conf.OmitArgPrefixes]
    description, box = f"{flags.__doc__}{MORE.get(flags, '')}", io.StringIO()
    if flags in (Train, Sweep) and {"-h", "--help"} & set(words):
        marks.append(tyro.conf.FlagCreatePairsOff)
        flags, default = short(default, unused(flatten(to_json(default.run))).keys() | {"imports"})
    try:
        with contextlib.redirect_stderr(box), NUMBERS, warnings.catch_warnings():
            # Settings that follow from the arm are numbers, and None until they are settled on one.
            warnings.filterwarnings("ignore", message=".*the default value `None` has type")
            prog = f"reachlab {verb}"
            return tyro.cli(flags, prog=prog, description=description, args=words, default=default, config=marks)
    except SystemExit as end:
        if not end.code:
            raise
        sentence = _refusal(end) or _of_other_tasks(words, default) or _sentence(box.getvalue())
        raise InputError(f"{sentence} See `reachlab {verb} --help`.") from None


def _of_other_tasks(words: list[str], default: Any) -> str | None:
    """A sentence on the first flag that is a setting of other tasks alone, if there is one."""
    if not isinstance(default, Train | Sweep):
        return None
    names = (word.partition("=")[0].removeprefix("--").replace("-", "_") for word in words if word.startswith("--"))
    return next(filter(None, (of_other_tasks(name.removeprefix("no_"), default.run) for name in names)), None)


def _imported(words: list[str]) -> list[str]:
    """The words without `--import`; its extensions are imported, those of installed packages and of runs among them."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--import", action="append", default=[], dest="names", nargs="?", const="")
    given, others = parser.parse_known_args(words)
    if any(word.partition("=")[0] == "--imports" for word in others):
        raise InputError("--imports is what a run notes for itself. Did you mean --import FILE?")
    import_installed()
    if given.names or extended():
        import_module("reachlab.envs.gymnasium_ids")  # which an extension may make environments by
    for name in given.names:
        import_extension(name)
    import_of_runs(others)
    return others


def _defaults(flags: type, chosen: argparse.Namespace) -> RunConfig:
    """Settings that the flags of a training change: those of the run that is resumed or of a file, or a preset.

    Raises:
        InputError: the file cannot be used, or a preset is named beside it.
    """
    if config := _resumed(flags, chosen):
        return config
    if not chosen.config:
        return preset(chosen.task or "tutorial", **{name: vars(chosen)[name] for name in CHOICES if vars(chosen)[name]})
    from reachlab.runs.directory import read_config

    if not Path(chosen.config).is_file():
        raise InputError(f"'{chosen.config}' is no file: --config takes the config.json of a run.")
    config = read_config(Path(chosen.config))
    if chosen.task not in (None, config.task):
        raise InputError(f"'{chosen.config}' holds settings of task {config.task!r}: leave --task out.")
    return config


def _resumed(flags: type, chosen: argparse.Namespace) -> RunConfig | None:
    """Settings of the run or the sweep that is resumed, if there is one."""
    if not chosen.resume:
        return None
    if chosen.config:
        raise InputError("--resume goes on with the settings that are there: leave --config out.")
    if flags is Sweep:
        from reachlab.scale.sweep import read_sweep

        read_sweep(Path(chosen.resume))
    from reachlab.runs.directory import RunDirectory

    return RunDirectory(Path(chosen.resume)).read_config(check_robot=False)


def _chosen(words: Sequence[str]) -> argparse.Namespace:
    """The flags on which the defaults of others depend; None where one is not given or has no value."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    for name in ("resume", "config", "task", *CHOICES):
        parser.add_argument(f"--{name}", nargs="?")
    return parser.parse_known_args(words)[0]


def _refusal(end: SystemExit) -> str | None:
    """Our own sentence, where a dataclass that tyro built refused a value: tyro exits while it handles that error."""
    cause = end.__context__
    while cause and not isinstance(cause, InputError):
        cause = cause.__context__
    return str(cause) if cause else None


def _sentence(box: str) -> str:
    """The first statement of tyro's framed message, and the flag that it suggests; frames may be drawn in ASCII.

    tyro has no public function that gives its message without the frame, so its version is bounded in pyproject.toml.
    """
    rows = [line.strip("│╭╮╰╯|+ ") for line in box.splitlines()[1:]]
    parts = [list(part) for rule, part in itertools.groupby(rows, lambda row: not row.strip("─-")) if not rule]
    text = " ".join(parts[0]).rstrip(".") + "."
    if found := LISTS.search(text):
        if " " in found[2] or "," not in found[2]:
            return f"{found[1]} takes numbers, got {found[2]}."
        return f"{found[1]} is a list, which is written with blanks: {found[1]} {found[2][1:-1].replace(',', ' ')}."
    if found := NO_NUMBERS.fullmatch(text):
        flag, kinds, given = found.groups()
        count = max(len(re.findall("FLOAT|INT", kinds)), 1)
        return f"{flag} takes {'a number' if count == 1 else f'{count} numbers'}, got {given.strip('[]')}."
    if found := MISSING.fullmatch(text):
        return "{} needs {}: {}.".format(*found.groups())
    if text.startswith("Unrecognized options: ") and "--" not in text:
        text += " A value follows its flag, as in --out FOLDER."
    for heading, *rest in parts[1:]:
        if heading.startswith("Perhaps you meant"):
            text += f" Did you mean {next(row for row in rest if row.startswith('--')).split()[0].rstrip(',')}?"
    return text
