# SPDX-License-Identifier: Apache-2.0
"""The file systems of servers, as fsspec opens them."""

from __future__ import annotations

import logging
from typing import Any

from multilica.ingest.address import scheme_of

__all__ = ["open_system"]

_CONNECT_S = 10
_READ_S = 30


def open_system(url: str) -> tuple[Any, str]:
    """The file system behind an address, and the path in it."""
    if scheme_of(url) == "gs":
        # What `fsspec` would choose first asks for the kind of the bucket over gRPC, without end where nobody answers.
        import gcsfs.core

        # What it logs before it raises would stand on the terminal where nobody has set up logging.
        logging.getLogger("gcsfs").addHandler(logging.NullHandler())
        system = gcsfs.core.GCSFileSystem(**_options(url), skip_instance_cache=True)
        return system, system._strip_protocol(url)  # noqa: SLF001 - as fsspec does it
    import fsspec

    opened: tuple[Any, str] = fsspec.url_to_fs(url, **_options(url), skip_instance_cache=True)
    return opened


def _options(url: str) -> dict[str, Any]:
    """Above all time limits, without which a server that falls silent is waited for without end."""
    scheme = scheme_of(url)
    if scheme == "s3":
        return {"config_kwargs": {"connect_timeout": _CONNECT_S, "read_timeout": _READ_S}}
    from aiohttp import ClientTimeout

    timeout = ClientTimeout(sock_connect=_CONNECT_S, sock_read=_READ_S)
    if scheme == "gs":
        return {"requests_timeout": timeout}
    # Ranges of a file that is compressed on its way are ranges of something else.
    client = {"timeout": timeout, "headers": {"Accept-Encoding": "identity"}}
    # A signed address is valid letter by letter.
    return {"client_kwargs": client, "encoded": "%" in url}
