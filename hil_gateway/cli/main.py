"""The `hil` command: one table of sub-commands, each imported only when it is called."""

from __future__ import annotations

import errno
import importlib
import os
import signal
import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

import can_dbc
from hil_gateway.cli.groups import Group
from hil_gateway.process.errors import EXIT_FAILURE, EXIT_INPUT, EXIT_SIGNAL, InputError, one_line
from hil_gateway.process.lifecycle import Interrupt, end_with_parent

COMMANDS: dict[str, tuple[str, str]] = {
    "demo": ("hil_gateway.cli.demo:app", "drive a simulated AV-24 around a track: the whole loop"),
    "gateway": ("hil_gateway.cli.gateway:app", "CAN to vehicle state, commands to CAN; bring-up check"),
    "estimator": ("estimator.cli.estimator:app", "state, tyre belief and model revisions"),
    "learner": ("estimator.cli.learner:app", "diagnosis beside the drive: proposes models with effects"),
    "planner": ("planner.cli.planner:app", "infomax MPCC: plans and commands"),
    "plant": ("hil_gateway.cli.plant:app", "the simulated AV-24 at the other end of the CAN cable"),
    "race-control": ("hil_gateway.cli.track_day.race_control:app", "flags, speed and kill to the simulated car"),
    "run": ("hil_gateway.cli.track_day.run:app", "runs: laps, caps on speed and grip, in lap"),
    "note": ("hil_gateway.cli.track_day.note:app", "a remark, or the tyre set that is on, into the running recording"),
    "day": (
        "hil_gateway.cli.track_day.day:app",
        "a folder of recordings as one page: runs, laps, tyres, stops",
    ),
    "season": ("hil_gateway.cli.track_day.season:app", "many days: what changed, when, and what was new then"),
    "identify": ("estimator.cli.identify:app", "tyre parameters from a session, error before and after"),
    "diagnose": ("estimator.cli.diagnose:app", "residual, missing effect, error before and after"),
    "plan": ("planner.cli.plan:app", "planner benchmark in closed loop on the model"),
    "campaign": ("hil_gateway.cli.laboratory:campaign", "long comparisons over seeds"),
    "recorder": ("hil_gateway.cli.recorder:app", "raw frames and topics into one MCAP file"),
    "session": ("hil_gateway.cli.session:app", "recordings: list, info, view, compare, export, import, replay"),
    "track": ("hil_gateway.cli.track_day.track:app", "a track as a page: road, pit lane, boxes, bends, bank"),
    "can": ("hil_gateway.cli.can:app", "the CAN bus in the terminal, decoded"),
    "dashboard": ("hil_gateway.cli.dashboard:app", "read-only live page"),
    "receiver": ("hil_gateway.cli.receiver:app", "GNSS and INS receivers on the network: checked, read, published"),
    "ros2": ("hil_gateway.cli.ros2:app", "bridge to ROS 2: the car's state out, a team's commands in"),
    "joystick": ("hil_gateway.cli.track_day.joystick:app", "a person drives, through the gateway's limits"),
    "verify": ("hil_gateway.cli.laboratory:verify", "the reliability promises at their stated figures"),
    "config": ("hil_gateway.cli.config:app", "every setting: value, origin, range; what differs from the default"),
    "doctor": ("hil_gateway.cli.doctor:app", "what this machine lacks for what, with the remedy"),
}
"""name -> (module:attribute of a Typer app, help line)"""

GROUPS: dict[str, tuple[str, ...]] = {
    "Drive": ("demo", "run", "note", "race-control", "joystick"),
    "Analyse": ("identify", "diagnose", "plan", "campaign"),
    "Sessions": ("session", "day", "season"),
    "Processes": ("gateway", "estimator", "learner", "planner", "plant", "recorder", "dashboard", "ros2", "receiver"),
    "Checks": ("can", "track", "config", "doctor", "verify"),
}
"""how `hil --help` lists them"""


class LazyGroup(TyperGroup):
    """Knows its sub-commands from the table, and imports one only to run it or to complete its options."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.commands = {name: TyperCommand(name, help=text, short_help=text) for name, (_, text) in COMMANDS.items()}

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """By what people want to do; the second column begins at the same place in every group."""
        width = max(map(len, self.commands))
        for title, names in GROUPS.items():
            with formatter.section(title):
                formatter.write_dl([(name.ljust(width), self.commands[name].short_help) for name in names])

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        name, command, rest = super().resolve_command(ctx, args)
        return name, _load(name) if name else command, rest


def _load(name: str) -> Any:
    """The command itself in the place of its entry in the list."""
    module, attribute = COMMANDS[name][0].split(":")
    sub: typer.Typer = getattr(importlib.import_module(module), attribute)
    sub.rich_markup_mode = None  # the same plain help everywhere
    sub._add_completion = False
    sub.info.cls = sub.info.cls if isinstance(sub.info.cls, type) else Group
    return typer.main.get_command(sub)


app = typer.Typer(
    cls=LazyGroup,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # plain help: importing rich would double its time
    help="Hardware-in-the-loop CAN gateway and active tyre-learning loop for the Dallara AV-24.",
)


def _print_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        print(f"hil {version('hil-gateway')}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", help="print the version", callback=_print_version, is_eager=True)
    ] = False,
    platform: Annotated[
        str, typer.Option(PLATFORM_OPTION, help="the car: name of a shipped one, or a folder; after any command, too")
    ] = "",
) -> None:
    """Hardware-in-the-loop CAN gateway and active tyre-learning loop for the Dallara AV-24."""


_UsageError: Any = typer.BadParameter.__bases__[0]
"""what typer raises for wrong arguments; its own module for it is private"""


INTERRUPTED = EXIT_SIGNAL + signal.SIGINT
"""what typer makes of a KeyboardInterrupt"""


def main() -> None:
    """Run the command line; bad input ends in one line on standard error and exit code 2."""
    end_with_parent()
    _take_platform(sys.argv)
    interrupt = Interrupt()
    try:
        code = _run()
        if code == INTERRUPTED and interrupt.signal:
            code = EXIT_SIGNAL + interrupt.signal
    except Exception:
        if not interrupt.signal:
            raise
        code = EXIT_SIGNAL + interrupt.signal
    finally:
        interrupt.over()
    raise SystemExit(_flushed(code))


def _take_platform(arguments: list[str]) -> None:
    """`--platform NAME|FOLDER`, which every command takes, into the variable that its processes read, too."""
    for index, argument in enumerate(arguments):
        name, equals, value = argument.partition("=")
        if name == PLATFORM_OPTION:
            taken = 1 if equals else 2
            value = value if equals else "".join(arguments[index + 1 : index + 2])
            shipped = (Path(can_dbc.__file__).parent / value / "car.toml").is_file()
            os.environ["HIL_PLATFORM"] = str(Path(value).absolute()) if Path(value).is_dir() and not shipped else value
            del arguments[index : index + taken]
            return


PLATFORM_OPTION = "--platform"


def _run() -> Any:
    """Exit code of the command."""
    try:
        return app(standalone_mode=False, prog_name="hil")
    except (InputError, ValueError) as error:
        theirs = type(error).__module__ == "can_dbc.errors"  # named, not imported: few commands need it
        if not (theirs or isinstance(error, InputError)):
            raise
        print(f"hil: {one_line(error)}", file=sys.stderr)
        return EXIT_INPUT
    except _UsageError as error:
        print(_explain_usage(error), file=sys.stderr)
        return EXIT_INPUT
    except BrokenPipeError:
        return EXIT_FAILURE
    except (KeyboardInterrupt, typer.Abort):
        return INTERRUPTED
    except OSError as error:
        return _explain_place(error)


def _explain_place(error: OSError) -> int:
    """A disk that is full, or a working directory that is gone, which only relative names need; else it is a bug."""
    if error.errno == errno.ENOENT and Path().stat().st_nlink == 0:
        print("hil: the working directory is not there any more; `cd` to one that is", file=sys.stderr)
        return EXIT_INPUT
    if error.errno != errno.ENOSPC:
        raise error
    return _say_full()


def _flushed(code: Any) -> Any:
    """`code`, or failure where what was printed last does not go out either."""
    try:
        if sys.stdout is not None:  # closed by whoever started this
            sys.stdout.flush()
        return code
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # Python tries once more on its way out
        return _say_full() if error.errno == errno.ENOSPC and code != EXIT_FAILURE else EXIT_FAILURE


def _say_full() -> int:
    print("hil: no space left on the disk that the output goes to; free some, or write elsewhere", file=sys.stderr)
    return EXIT_FAILURE


def _explain_usage(error: Any) -> str:
    """One line, or the help of a group that was called without a command."""
    text = str(error.format_message()).strip().replace("Value error, ", "")  # pydantic's
    command = error.ctx.command_path if error.ctx else "hil"
    if "\n" in text:
        return text
    text = text if text.endswith("?") else text.rstrip(".") + ";"
    return f"hil: {text} `{command} --help` lists what there is"
