# SPDX-License-Identifier: Apache-2.0
"""A network that fails every few seconds: ``faulty_proxy.py PORT PERIOD_S`` stands before the server on PORT.

In turn, it resets the connections, delivers nothing for half a period, and delivers random bytes.
"""

from __future__ import annotations

import asyncio
import random
import socket
import struct
import sys
from itertools import cycle

BLOCK_BYTES = 1 << 16
GARBAGE_BYTES = 300


class Proxy:
    """Connections to one server."""

    def __init__(self, port: int) -> None:
        self.port = port
        self.clients: set[asyncio.StreamWriter] = set()
        self.flowing = asyncio.Event()
        self.flowing.set()
        self.draw = random.Random(0)  # noqa: S311

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Pass on what both sides send."""
        from_server, to_server = await asyncio.open_connection("127.0.0.1", self.port)
        self.clients.add(writer)
        pumps = [
            asyncio.create_task(self._pump(reader, to_server)),
            asyncio.create_task(self._pump(from_server, writer)),
        ]
        await asyncio.wait(pumps, return_when=asyncio.FIRST_COMPLETED)
        for pump in pumps:
            pump.cancel()
        await asyncio.gather(*pumps, return_exceptions=True)
        self.clients.discard(writer)
        to_server.close()
        writer.close()

    async def _pump(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while data := await reader.read(BLOCK_BYTES):
            await self.flowing.wait()
            writer.write(data)
            await writer.drain()

    async def fail(self, period_s: float) -> None:
        """Fail in turn, without end."""
        for fault in cycle(("reset", "stall", "garbage")):
            await asyncio.sleep(period_s)
            if fault == "stall":
                self.flowing.clear()
                await asyncio.sleep(period_s / 2)
                self.flowing.set()
            for client in list(self.clients) if fault != "stall" else ():
                if fault == "reset":
                    linger = struct.pack("ii", 1, 0)
                    client.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, linger)
                    client.transport.abort()
                else:
                    client.write(self.draw.randbytes(GARBAGE_BYTES))


async def main(port: int, period_s: float) -> None:
    proxy = Proxy(port)
    server = await asyncio.start_server(proxy.serve, "127.0.0.1", 0)
    print(server.sockets[0].getsockname()[1], flush=True)
    await proxy.fail(period_s)


if __name__ == "__main__":
    asyncio.run(main(int(sys.argv[1]), float(sys.argv[2])))
