# SPDX-License-Identifier: Apache-2.0
"""A web server of files that tells how much it sent: ``file_server.py DIRECTORY``."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path

from aiohttp import web

LOST_AFTER_BYTES = 1 << 20
"""What `/lost` sends in all before its connections break."""


class Server:
    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.sent = {"/files": 0, "/lost": 0}
        self.asked = 0

    def app(self) -> web.Application:
        app = web.Application()
        app.router.add_get("/sent", self.tell)
        app.router.add_get("/whole/{name}", self.whole)
        app.router.add_get("/streamed/{name}", self.streamed)
        app.router.add_get("/denied/{name}", self.denied)
        app.router.add_get("/busy/{name}", self.busy)
        app.router.add_get("/lost/{name}", self.lost)
        app.router.add_get("/shaky/{name}", self.shaky)
        app.router.add_static("/files", self.folder, follow_symlinks=True)
        app.on_response_prepare.append(self.count)
        return app

    async def count(self, request: web.Request, response: web.StreamResponse) -> None:
        if request.method == "GET" and request.path.startswith("/files") and response.status == 206:
            self.sent["/files"] += response.content_length

    async def tell(self, _: web.Request) -> web.Response:
        return web.Response(text=str(self.sent["/files"]))

    async def whole(self, request: web.Request) -> web.Response:
        """Every byte, whatever range is asked for."""
        return web.Response(body=(self.folder / request.match_info["name"]).read_bytes())

    async def streamed(self, request: web.Request) -> web.StreamResponse:
        """Every byte, and nobody knows before how many."""
        response = web.StreamResponse()
        await response.prepare(request)
        if request.method == "GET":
            await response.write((self.folder / request.match_info["name"]).read_bytes())
        await response.write_eof()
        return response

    async def denied(self, _: web.Request) -> web.Response:
        return web.Response(status=403)

    async def busy(self, _: web.Request) -> web.Response:
        return web.Response(status=503)

    async def lost(self, request: web.Request) -> web.StreamResponse:
        if request.method == "GET":
            self.sent["/lost"] += request.http_range.stop - request.http_range.start
            if self.sent["/lost"] > LOST_AFTER_BYTES:
                request.transport.abort()
        return web.FileResponse(self.folder / request.match_info["name"])

    async def shaky(self, request: web.Request) -> web.StreamResponse:
        """Breaks two of four connections, one after the other: the client asks again by itself after the first."""
        self.asked += request.method == "GET"
        if self.asked % 4 > 1:
            request.transport.abort()
        return web.FileResponse(self.folder / request.match_info["name"])


async def main(folder: Path) -> None:
    runner = web.AppRunner(Server(folder).app())
    await runner.setup()
    site = web.TCPSite(runner, "127.0.0.1", 0)
    await site.start()
    print(runner.addresses[0][1], flush=True)
    await asyncio.Event().wait()


if __name__ == "__main__":
    asyncio.run(main(Path(sys.argv[1])))
