"""The command line: quick help, one clear line for bad input, exit codes 0, 1, 2."""

from __future__ import annotations

import importlib
import importlib.util
import json
import os
import re
import socket
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest
from support.preloaded import hil_preloaded

from hil_gateway.cli.doctor import findings, missing_packages
from hil_gateway.cli.main import COMMANDS, GROUPS
from hil_gateway.config import Config, ZenohConfig, load_config

ROOT = Path(__file__).resolve().parents[4]


def hil(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run `hil ARGUMENTS` as a user does."""
    command = [sys.executable, "-m", "hil_gateway", *arguments]
    return subprocess.run(
        command, capture_output=True, text=True, timeout=120, check=False, env={**os.environ, **environment}
    )


def test_help_lists_every_command_and_imports_none_of_them() -> None:
    code = "import sys; sys.argv = ['hil', '--help']\nfrom hil_gateway.cli.main import main\n"
    code += "try: main()\nexcept SystemExit: pass\n"
    code += (
        "heavy = {'numpy', 'casadi', 'scipy', 'zenoh', 'can', 'pydantic', 'matplotlib', 'rich'} & set(sys.modules)\n"
    )
    code += "print('HEAVY', sorted(heavy))"
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert "HEAVY []" in shown
    assert all(re.search(rf"^  {name} ", shown, re.MULTILINE) for name in COMMANDS)


def test_every_command_is_listed_in_one_group() -> None:
    assert sorted(name for names in GROUPS.values() for name in names) == sorted(COMMANDS)


def test_help_appears_within_300_ms_of_processor_time() -> None:
    def processor_s() -> float:
        begin = os.times()
        hil("--help")
        end = os.times()
        return end.children_user + end.children_system - begin.children_user - begin.children_system

    assert min(processor_s() for _ in range(5)) < 0.3


def test_version_is_that_of_the_package() -> None:
    assert hil("--version").stdout == f"hil {version('hil-gateway')}\n"


@pytest.mark.parametrize(
    ("typed", "offered"),
    [("hil doc", "doctor"), ("hil demo --lap", "--laps"), ("hil session exp", "export")],
)
def test_shell_completes_commands_and_their_options(typed: str, offered: str) -> None:
    shell = {"_HIL_COMPLETE": "complete_bash", "COMP_WORDS": typed, "COMP_CWORD": str(len(typed.split()) - 1)}
    assert offered in hil_script(**shell).splitlines()


def hil_script(**environment: str) -> str:
    """Output of the installed `hil`, without arguments."""
    command = [sys.executable, "-c", "from hil_gateway.cli.main import main; main()"]
    shown = subprocess.run(
        command, capture_output=True, text=True, timeout=120, check=True, env={**os.environ, **environment}
    )
    return shown.stdout


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_of_the_table_can_be_asked_for_help(name: str) -> None:
    module, attribute = COMMANDS[name][0].split(":")
    assert hasattr(importlib.import_module(module), attribute)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("nonsense",), "nonsense"),
        (("demoo",), "Did you mean 'demo'?"),
        (("session", "exprt"), "Did you mean 'export'?"),
        (("demo", "--track", "road_curse"), "did you mean road_course?"),
        (("doctor", "--template", "av42.toml"), "av42.toml"),
        (("demo", "--laps", "many"), "'--laps': Input should be a valid integer"),
        (("demo", "--laps", "0"), "--laps 0"),
        (("demo", "--track", "nowhere.csv"), "nowhere.csv"),
        (("demo", "--channel", "can77"), "can77"),
        (("demo", "--effect", "aero_drag"), "NAME=SIZE"),
        (("session", "info", "absent.mcap"), "absent.mcap"),
        (("session", "export", "absent.mcap", "--format", "pdf"), "pdf"),
        (("doctor", "--config", "absent.toml"), "absent.toml"),
    ],
)
def test_bad_input_is_one_clear_line_and_exit_code_2(arguments: tuple[str, ...], words: str, tmp_path: Path) -> None:
    extra = ("--out", str(tmp_path)) if arguments[0] == "demo" else ()
    result = hil_preloaded(tmp_path, *arguments, *extra)
    assert result.returncode == 2
    assert words in result.stderr
    assert result.stderr.startswith("hil: ")
    assert len(result.stderr.splitlines()) == 1
    assert result.stdout == ""


WRONG: list[tuple[str, str]] = [
    ("identify --out /etc/passwd x.csv", "/etc/passwd is no folder"),
    ("identify x.csv --out /proc/x", "nothing can be written in /proc"),
    ("identify x.csv --out file/below", "file is no folder"),
    ("identify x.csv --tyre d/tyre.json --out d", "d/tyre.json: never written over, it is what is read"),
    ("identify absent.csv --out new", "absent.csv: cannot read"),
    ("identify x.csv --window abc", "--window"),
    ("diagnose x.csv --out x.csv", "x.csv is no folder"),
    ("diagnose x.csv --layout both --out new", "must be per_axle or shared"),
    ("session export s.mcap --out x.foo", "known: .csv (csv), .parquet (parquet), .log (candump)"),
    ("session export s.mcap --out bare", "no ending that names the format"),
    ("session export s.mcap --format csv --out file", "there already and no .csv file"),
    ("session export s.mcap --out s.mcap --format csv", "never written over, it is what is read"),
    ("session export s.mcap --format ros2 --out foreign/session.mcap", "a recording is never written over"),
    ("session recover s.mcap --out d", "is a folder, a file is needed"),
    ("session import a.log --out /proc/y.mcap", "nothing can be written in /proc"),
    ("session replay s.mcap --speed -1", "--speed -1"),
    ("plan bench --track nowhere", "nowhere: no such track file"),
    ("plan contraction --places 1", "--places"),
    ("campaign learn --out file --seeds 2", "file is no folder"),
    ("campaign learn --out new --track nowhere", "nowhere: no such track file"),
    ("campaign learn --out new --criterion magic", "must be one of trace, log_det"),
    ("campaign learn --out new --scheduler nowhere:1", "needs dask"),
    ("campaign diagnose --out new --effects magic", "magic: unknown effect"),
    ("campaign closed --effects magic=1", "effect 'magic' is unknown"),
    ("campaign closed --effects ,", "names no effect"),
    ("verify --seeds -4", "--seeds -4"),
    ("verify --from absent.jsonl", "absent.jsonl: no such file"),
    ("gateway emergency --config absent.toml", "absent.toml: cannot read"),
    ("gateway run --config bad.toml", "bad.toml: not valid TOML"),
    ("planner run --config limits.toml", "planner.load_limits"),
    ("recorder run --config folder.toml", "choose another recorder.folder"),
    ("demo --out file", "file is no folder"),
    ("demo --out foreign", "not made by a demo here"),
    ("demo --out foreign --config foreign/config.toml", "was given to the demo"),
    ("demo --out /dev/null/x", "/dev/null is no folder"),
    ("demo --out " + "x" * 300, "a name of 300 bytes is too long (limit 255)"),
    ("sesion info", "sesion"),
]
"""wrong calls in the folder `wrong_folder` makes -> words of the one line they end in"""


@pytest.fixture(scope="module")
def wrong_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wrong")
    files = {
        "x.csv": "t,vx,vy,yaw_rate,ax,ay,steer,drive\n", "a.log": "", "file": "of somebody", "bad.toml": "[planner\n",
        "limits.toml": '[planner]\nload_limits = "d"\n', "folder.toml": '[recorder]\nfolder = "file/below"\n',
        "d/tyre.json": "{}", "s.mcap": "no session", "foreign/session.mcap": "of a car", "foreign/config.toml": "",
    }  # fmt: skip
    for name, text in files.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text)
    return folder


@pytest.mark.parametrize(("call", "words"), WRONG, ids=[call[:60] for call, _ in WRONG])
def test_a_wrong_call_is_one_line_exit_2_and_changes_nothing(
    call: str, words: str, wrong_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Refused before any work: nothing is made, written over or said on standard output, and no bar is drawn."""
    if "scheduler" in call and importlib.util.find_spec("distributed"):
        pytest.skip("dask is installed here: the scheduler would be asked")
    monkeypatch.chdir(wrong_folder)
    before = {path: path.read_bytes() for path in wrong_folder.rglob("*") if path.is_file()}
    result = hil_preloaded(tmp_path, *call.split(" "))
    assert (result.returncode, result.stdout) == (2, "")
    assert words in result.stderr
    assert result.stderr.startswith("hil: ")
    assert len(result.stderr.splitlines()) == 1, result.stderr
    assert {path: path.read_bytes() for path in wrong_folder.rglob("*") if path.is_file()} == before


def test_unknown_key_in_the_environment_is_named() -> None:
    result = hil("doctor", HIL_CAN__CHANEL="can0")
    assert result.returncode == 2
    assert "can.chanel" in result.stderr


def test_doctor_json_is_one_object_and_every_lack_has_a_remedy() -> None:
    report = json.loads(hil("doctor", "--json").stdout)
    assert report["ok"]
    assert {"python", "packages", "package data", "socketcan", "disk"} <= {check["name"] for check in report["checks"]}
    assert all(check["remedy"] and check["needed_for"] for check in report["checks"] if not check["ok"])


def test_doctor_names_the_solvers_that_the_planner_uses() -> None:
    said = json.loads(hil("plan", "solver", "--json").stdout)
    checks = json.loads(hil("doctor", "--json").stdout)["checks"]
    detail = next(check["detail"] for check in checks if check["name"] == "planner's solver")
    without = f"{said['first']}: {said['lacks']}"
    assert detail == (without if said["lacks"] else f"{said['first']}, then {said['second']}")


def test_doctor_says_what_is_wrong_with_an_odd_set_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A busy port, a home that cannot be written, a working directory that is gone: never a traceback."""
    gone = tmp_path / "gone"
    gone.mkdir()
    monkeypatch.chdir(gone)
    gone.rmdir()
    monkeypatch.setenv("XDG_CACHE_HOME", "/proc")
    with socket.create_server(("127.0.0.1", 0)) as busy:
        port = busy.getsockname()[1]
        config = Config(zenoh=ZenohConfig(connect=(f"tcp/127.0.0.1:{port}",)))
        rows = {row.name: row for row in findings(config)}
    assert [rows[name].ok for name in ("disk", "compiled functions", "zenoh endpoint")] == [False] * 3
    assert "in use" in rows["zenoh endpoint"].detail
    assert all(rows[name].remedy for name in ("disk", "compiled functions", "zenoh endpoint"))


def test_doctor_names_the_package_of_every_missing_program(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "/nonexistent")
    assert {"can-utils", "chromium", "iproute2"} <= set(missing_packages())
    lacking = [f for f in findings(Config()) if f.name == "candump"]
    assert lacking[0].remedy == "apt-get install can-utils"


def test_config_show_lists_every_setting_with_its_origin(tmp_path: Path) -> None:
    (tmp_path / "c.toml").write_text("[planner]\nhorizon = 30\n")
    shown = hil("config", "show", "--config", str(tmp_path / "c.toml"), "--json", HIL_CAN__CHANNEL="can9")
    table = {row["key"]: row for row in json.loads(shown.stdout)["settings"]}
    assert (table["planner.horizon"]["value"], table["planner.horizon"]["origin"]) == (30, str(tmp_path / "c.toml"))
    assert (table["can.channel"]["value"], table["can.channel"]["origin"]) == ("can9", "HIL_CAN__CHANNEL")
    assert table["vehicle.mass"]["origin"] == "default"
    assert {key.split(".")[0] for key in table} == set(Config.model_fields)


def test_configuration_for_the_car_is_valid_and_listens_only() -> None:
    config = load_config(ROOT / "deploy" / "av24.toml")
    assert config.gateway.mode == "listen"
    assert config.can.interface == "socketcan"


@pytest.mark.parametrize("page", sorted([ROOT / "README.md", *(ROOT / "docs").glob("*.md")]), ids=lambda p: p.name)
def test_every_link_between_documents_leads_somewhere(page: Path) -> None:
    targets = re.findall(r"\]\((?!https?:|#)([^)#]+)", page.read_text())
    assert [t for t in targets if not (page.parent / t).exists()] == []


def test_commands_in_the_readme_exist() -> None:
    shown = re.findall(r"\bhil ([a-z]+)", (ROOT / "README.md").read_text())
    assert shown
    assert set(shown) <= set(COMMANDS)


NOTATION = re.findall(r"((?:`[\w.]+`, )*`[\w.]+`) of `([a-z]\w+\.[\w.]+)`", (ROOT / "docs" / "notation.md").read_text())


def test_notation_names_what_is_in_the_code() -> None:
    """Every function, class or field the table names is found in the module it gives for it."""
    assert len(NOTATION) > 15
    for names, place in NOTATION:
        for name in re.findall(r"`([\w.]+)`", names):
            assert re.search(rf"\b{name.split('.')[-1]}\b", _source(place)), f"{name} is not in {place}"


def _source(place: str) -> str:
    """Source of the module that `place` (module, or module.Name) lies in."""
    path = ROOT.joinpath(*place.split("."))
    path = path.with_suffix(".py") if path.with_suffix(".py").exists() else path.parent.with_suffix(".py")
    return path.read_text()


@pytest.mark.parametrize("arguments", ["--version", "config show --json", "doctor --json"])
def test_output_that_does_not_fit_on_the_disk_is_one_line(arguments: str) -> None:
    """A short text is only found not to fit when it is flushed, a long one while it is written."""
    with Path("/dev/full").open("wb") as full:
        command = [sys.executable, "-m", "hil_gateway", *arguments.split()]
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr.startswith("hil: no space left on the disk that the output goes to")
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("car", "said"),
    [({"mass": [1e9] * 5000}, "valid number"), ({"mass\n\x1b[2J": 1}, r"mass\n\x1b[2J"), ({"a" * 5000: 1}, "aaa")],
)
def test_what_is_long_or_would_move_the_cursor_is_one_short_line(tmp_path: Path, car: dict, said: str) -> None:
    path = tmp_path / "car.json"
    path.write_text(json.dumps({"mass": 787, "yaw_inertia": 1000, "lf": 1.7, "lr": 1.3, **car}))
    result = hil("identify", "x.csv", "--vehicle", str(path))
    assert result.returncode == 2
    assert said in result.stderr
    assert result.stderr[:-1].isprintable()
    assert len(result.stderr) < 1000


@pytest.mark.parametrize("arguments", ["demo --seconds 1 --headless", "demo --out there --laps 1"])
def test_a_working_directory_that_is_gone_is_one_line(tmp_path: Path, arguments: str) -> None:
    gone = tmp_path / "gone"
    gone.mkdir()
    run = f"import os, runpy, sys; os.rmdir(os.getcwd()); sys.argv = {['hil', *arguments.split()]!r}"
    command = [sys.executable, "-c", f"{run}; runpy.run_module('hil_gateway', run_name='__main__')"]
    ended = subprocess.run(command, cwd=gone, capture_output=True, text=True, timeout=120, check=False)
    assert (ended.returncode, ended.stderr) == (
        2,
        "hil: the working directory is not there any more; `cd` to one that is\n",
    )


def test_a_choice_that_is_none_is_refused_in_plain_words() -> None:
    refused = hil("race-control", "flag", "blue")
    assert refused.returncode == 2
    assert refused.stderr.startswith("hil: Invalid value for 'name': 'blue' is not one of 'green', 'yellow', ")


def test_help_lists_commands_in_whole_sentences() -> None:
    assert "..." not in hil("day", "--help").stdout.partition("Commands:")[2]
    listed = hil("session", "--help").stdout.partition("Commands:")[2]
    assert "..." not in listed
    assert "with --estimate one that identify and diagnose can work on" in " ".join(listed.split())


def test_columns_of_ros_topics_stay_in_line() -> None:
    rows = hil("ros2", "topics").stdout.splitlines()
    assert len({row.index("RIHS01_") for row in rows}) == 1
