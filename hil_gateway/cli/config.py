"""`hil config show` and `diff`: every setting with where it came from, what it may be, and what it means."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import typer
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from hil_gateway.config import DEFAULT_ORIGIN, Config, origins
from hil_gateway.process.figures import print_json

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None, no_args_is_help=True)

ConfigFile = Annotated[Path | None, typer.Option("--config", help="configuration (TOML)")]
AsJson = Annotated[bool, typer.Option("--json", help="one JSON object on standard output")]
BOUNDS = (("ge", ">="), ("gt", ">"), ("le", "<="), ("lt", "<"))


@app.callback()
def _group() -> None:
    """The settings in force."""


@app.command()
def show(config: ConfigFile = None, as_json: AsJson = False) -> None:
    """Every setting: value, origin, range, meaning."""
    _print(list(settings(config)), as_json)


@app.command()
def diff(config: ConfigFile = None, as_json: AsJson = False) -> None:
    """Only the settings that a file or a variable has changed, with the default beside them."""
    _print([row for row in settings(config) if row["origin"] != DEFAULT_ORIGIN], as_json)


def settings(path: Path | None) -> Iterator[dict[str, Any]]:
    """One row a setting.

    Raises:
        InputError: a configuration that is not valid.
    """
    defaults = Config().model_dump(mode="json")
    for key, (value, origin) in origins(path).items():
        field = _field(key)
        yield {
            "key": key, "value": value, "default": _at(defaults, key), "origin": origin,
            "range": _range(field) if field else "", "meaning": (field.description or "") if field else "",
        }  # fmt: skip


def _field(key: str) -> FieldInfo | None:
    """The declaration of a dotted key; None inside a free table."""
    model: type[BaseModel] | None = Config
    field: FieldInfo | None = None
    for part in key.split("."):
        field = model.model_fields.get(part) if model else None
        annotation = field.annotation if field else None
        model = annotation if isinstance(annotation, type) and issubclass(annotation, BaseModel) else None
    return field


def _range(field: FieldInfo) -> str:
    """Bounds or choices, as text."""
    bounds = [
        f"{sign} {getattr(limit, name)}" for limit in field.metadata for name, sign in BOUNDS if hasattr(limit, name)
    ]
    choices = getattr(field.annotation, "__args__", ()) if "Literal" in str(field.annotation) else ()
    return " | ".join(map(str, choices)) or ", ".join(bounds)


def _at(tree: Any, key: str) -> Any:
    for part in key.split("."):
        tree = tree.get(part) if isinstance(tree, dict) else None
    return tree


def _print(rows: list[dict[str, Any]], as_json: bool) -> None:
    if as_json:
        print_json({"settings": rows})
        return
    for row in rows:
        default = "" if row["value"] == row["default"] else f"default {row['default']}; "
        changed = "" if row["origin"] == DEFAULT_ORIGIN else f" ({default}{row['origin']})"
        about = "; ".join(filter(None, (row["range"], row["meaning"])))
        print(f"{row['key']} = {row['value']}{changed}{f'   # {about}' if about else ''}")
    if not rows:
        print("every setting has its default")
