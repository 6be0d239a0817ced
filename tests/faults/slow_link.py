"""A TCP relay that delays and stalls: a poor network between two computers where the kernel has no netem.

usage: slow_link.py LISTEN_PORT TARGET_HOST TARGET_PORT CONTROL_FILE; the file, read again ten times a second, holds
"DELAY_S STALL_PROBABILITY STALL_S".
"""

from __future__ import annotations

import asyncio
import random
import sys
from pathlib import Path


class Link:
    """The quality of the line, the same in both directions."""

    def __init__(self, control: Path) -> None:
        self.control, self.rng = control, random.Random(1)
        self.delay_s = self.stall = self.stall_s = 0.0

    async def follow(self) -> None:
        while True:
            self.delay_s, self.stall, self.stall_s = map(float, self.control.read_text().split())
            await asyncio.sleep(0.1)

    async def pump(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Bytes in order, each late by the delay; a lost packet costs a retransmission time."""
        loop, free_at = asyncio.get_running_loop(), 0.0
        queue: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue(10_000)

        async def drain() -> None:
            while True:
                due, data = await queue.get()
                await asyncio.sleep(max(due - loop.time(), 0.0))
                writer.write(data)
                await writer.drain()

        draining = asyncio.create_task(drain())
        while data := await reader.read(65536):
            due = max(loop.time() + self.delay_s, free_at)
            if self.rng.random() < self.stall:
                due += self.stall_s
            free_at = due
            await queue.put((due, data))
        draining.cancel()
        writer.close()


async def main() -> None:
    port, host, target, control = int(sys.argv[1]), sys.argv[2], int(sys.argv[3]), Path(sys.argv[4])
    link = Link(control)

    async def accept(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            far_reader, far_writer = await asyncio.open_connection(host, target)
        except OSError:
            writer.close()
            return
        await asyncio.gather(link.pump(reader, far_writer), link.pump(far_reader, writer), return_exceptions=True)

    server = await asyncio.start_server(accept, "127.0.0.1", port)
    following = asyncio.create_task(link.follow())
    async with server:
        await asyncio.gather(server.serve_forever(), following)


if __name__ == "__main__":
    asyncio.run(main())
