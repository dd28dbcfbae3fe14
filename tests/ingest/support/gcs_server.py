# SPDX-License-Identifier: Apache-2.0
"""A server on loopback that speaks as Google Cloud Storage does."""

from __future__ import annotations

import time

from gcp_storage_emulator.server import create_server

if __name__ == "__main__":
    server = create_server("127.0.0.1", 0, in_memory=True)
    server.start()
    print(server._api._httpd.server_address[1], flush=True)
    while True:
        time.sleep(60.0)
