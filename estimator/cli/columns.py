"""`hil session columns`: what each column of a drive log is taken for, as a map that a person confirms or changes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hil_gateway.process.figures import print_json, printable
from hil_gateway.process.writable import check_file


def columns(
    log: Annotated[Path, typer.Argument(help="a drive log of any kind")],
    out: Annotated[Path | None, typer.Option("--out", help="map file (TOML) to write")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="one JSON object on standard output")] = False,
) -> None:
    """Propose which column is which quantity, in which unit; edit the file and give it as --columns."""
    from estimator.drive_log.column_map import as_toml, proposed
    from estimator.drive_log.table import DERIVABLE, REQUIRED
    from estimator.drive_log.tables import read_table

    table = read_table(log)
    mapping = proposed(table.names, table.units)
    used = {source.source: quantity for quantity, source in mapping.sources.items()}
    missing = [name for name in (*REQUIRED, *DERIVABLE) if name not in mapping.sources]
    if out is not None:
        check_file(out, (log,))
        out.write_text(as_toml(mapping), encoding="utf-8")
    if as_json:
        sources = {quantity: source.model_dump(by_alias=True) for quantity, source in mapping.sources.items()}
        print_json({"columns": sources, "missing": missing, "other": [n for n in table.names if n not in used]})
        return
    for name, unit in zip(table.names, table.units, strict=True):
        quantity = used.get(name)
        declared = mapping.sources[quantity].unit if quantity else unit
        print(printable(f"{name:32} {declared or 'no unit':10} {quantity or 'carried along'}"))
    print(f"not there: {', '.join(missing) or 'nothing'}" + (f"; map written to {out}" if out else ""))
