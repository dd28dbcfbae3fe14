# SPDX-License-Identifier: Apache-2.0
"""A web server that breaks every rule: ``hostile_server.py``; the path chooses which."""

from __future__ import annotations

import socket
import struct
import threading
import time

PERIOD_S = 0.05
OK = b"HTTP/1.1 200 OK\r\nContent-Length: 1000000\r\nAccept-Ranges: bytes\r\n\r\n"
PART = b"HTTP/1.1 206 Partial Content\r\nContent-Length: %d\r\nContent-Range: bytes %d-%d/1000000\r\n\r\n"
REDIRECT = b"HTTP/1.1 302 Found\r\nLocation: %b\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
HEADS = {
    "loop": REDIRECT % b"PATH",
    "nowhere": REDIRECT % b"http://[::bad",
    "garbage": b"\x00\xff\x13 what is HTTP?\r\n\r\n",
    "length": b"HTTP/1.1 200 OK\r\nContent-Length: -5\r\nAccept-Ranges: bytes\r\n\r\n",
    "huge": OK.replace(b"1000000", b"9" * 18),
    "headers": b"HTTP/1.1 200 OK\r\nX-A: " + b"a" * 100_000 + b"\r\n\r\n",
}
WHOLE = PART % (10**6, 0, 10**6 - 1)
BODIES = {
    "drip": (WHOLE, bytes(10**6)),
    "drip_whole": (b"HTTP/1.1 200 OK\r\n\r\n", bytes(10**6)),
    "endless": (b"HTTP/1.1 206 Partial Content\r\n\r\n", b""),
    "short": (WHOLE, bytes(100)),
}
LATER = ("drip", "endless", "short")
"""These tell their size properly at first."""


def answer(connection: socket.socket, request: bytes) -> None:
    method, path, *_ = request.split()
    kind = path.strip(b"/").split(b"/")[0].decode()
    if kind == "reset":
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    elif kind == "drip_head":
        drip(connection, OK)
    else:
        head, body = BODIES[kind] if kind in BODIES else (HEADS[kind].replace(b"PATH", path), b"")
        connection.sendall(OK if method == b"HEAD" and kind in LATER else head)
        while method != b"HEAD" and kind == "endless":
            connection.sendall(bytes(1 << 20))
        if method != b"HEAD" and kind.startswith("drip"):
            drip(connection, body)
        elif method != b"HEAD":
            connection.sendall(body)


def drip(connection: socket.socket, data: bytes) -> None:
    for byte in data:
        connection.sendall(bytes([byte]))
        time.sleep(PERIOD_S)


def serve(connection: socket.socket) -> None:
    try:
        request = b""
        while b"\r\n\r\n" not in request:
            received = connection.recv(4096)
            if not received:
                return
            request += received
        answer(connection, request)
    except OSError:
        pass
    finally:
        connection.close()


def main() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        print(listener.getsockname()[1], flush=True)
        while True:
            connection, _ = listener.accept()
            threading.Thread(target=serve, args=(connection,), daemon=True).start()


if __name__ == "__main__":
    main()
