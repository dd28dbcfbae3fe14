# SPDX-License-Identifier: Apache-2.0
"""An S3-compatible server on loopback."""

from __future__ import annotations

import time

from moto.moto_server.threaded_moto_server import ThreadedMotoServer

if __name__ == "__main__":
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    print(server.get_host_and_port()[1], flush=True)
    while True:
        time.sleep(60.0)
