"""A long recording read by two processes, in turn: while one reads a piece, the other reads the next.

Where a piece begins is found by what a chunk looks like. It is taken only where the reader before it has come to the
very same place with nothing new declared; else that reader reads on alone.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from multiprocessing import parent_process
from typing import TypeVar

from hil_gateway.process.children import pool
from hil_gateway.session.files.chunk import Messages
from hil_gateway.session.files.reader import SessionReader

PIECE_BYTES = 1 << 24
"""a second's work: little beside the memory of either process"""
LONG_BYTES = 8 * PIECE_BYTES
"""from here on a second process saves more than the second or two that it takes to start"""
T = TypeVar("T")
Take = Callable[[SessionReader, Messages], T]


def in_turn(reader: SessionReader, take: Take[T]) -> Iterator[T]:
    """What `take`, a function of a module, makes of every batch of `reader`, in the order of the file.

    Raises:
        InputError: as `SessionReader.batches`.
    """
    alone = parent_process() is not None or len(os.sched_getaffinity(0)) < 2  # of a season, or of a small computer
    if alone or not reader.path.is_file() or reader.path.stat().st_size < LONG_BYTES:
        yield from (take(reader, messages) for messages in reader.batches())
        return
    with pool(1) as second:
        while (begin := reader.chunk_behind(reader.offset + PIECE_BYTES)) is not None:
            if (end := reader.chunk_behind(begin + PIECE_BYTES)) is None:
                break
            known = reader.ahead(begin)
            piece = second.submit(_piece, known, end, take)
            yield from (take(reader, messages) for messages in reader.batches(begin))
            if reader.went_as(known):
                read, taken = piece.result()
                if reader.go_on_behind(read):
                    yield from taken
    yield from (take(reader, messages) for messages in reader.batches())


def _piece(reader: SessionReader, end: int, take: Take[T]) -> tuple[SessionReader, list[T]]:
    return reader, [take(reader, messages) for messages in reader.batches(end)]
