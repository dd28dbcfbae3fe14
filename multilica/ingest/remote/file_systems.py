# SPDX-License-Identifier: Apache-2.0
"""The file systems of servers, opened by fsspec."""

import logging
from typing import Any

from multilica.ingest.remote.address import scheme_of

__all__ = ["open_system"]

_CONNECT_S = 10
_READ_S = 30


def open_system(url: str) -> tuple[Any, str]:
    """Return the file system of an address and the path in it."""
    if scheme_of(url) == "gs":
        # The default of fsspec asks for the kind of the bucket over gRPC, and waits forever if nobody answers.
        import gcsfs.core

        # Without a handler, the errors that it logs before raising would appear on the terminal.
        logging.getLogger("gcsfs").addHandler(logging.NullHandler())
        system = gcsfs.core.GCSFileSystem(**_options(url), skip_instance_cache=True)
        return system, system._strip_protocol(url)  # noqa: SLF001 - as fsspec does it
    import fsspec

    opened: tuple[Any, str] = fsspec.url_to_fs(url, **_options(url), skip_instance_cache=True)
    return opened


def _options(url: str) -> dict[str, Any]:
    """Return the options of a file system, most of all time limits: the defaults wait forever for a silent server."""
    scheme = scheme_of(url)
    if scheme == "s3":
        return {"config_kwargs": {"connect_timeout": _CONNECT_S, "read_timeout": _READ_S}}
    from aiohttp import ClientTimeout

    timeout = ClientTimeout(sock_connect=_CONNECT_S, sock_read=_READ_S)
    if scheme == "gs":
        return {"requests_timeout": timeout}
    # Ranges of a response that is compressed are not ranges of the file.
    client = {"timeout": timeout, "headers": {"Accept-Encoding": "identity"}}
    # The signature of an address covers its exact text.
    return {"client_kwargs": client, "encoded": "%" in url}
