# SPDX-License-Identifier: Apache-2.0
"""Addresses as sources."""

import re
from pathlib import Path, PurePosixPath
from urllib.parse import urlsplit

from multilica.documents import local_path
from multilica.errors import UsageError

_FILES = ("s3", "gs", "https", "http")
_BUCKETS = ("s3", "gs")
ROS2 = "ros2"
"""The nodes of a ROS 2 domain."""
_LIVE = ("ws", "wss", ROS2)
"""Bridges with the Foxglove WebSocket protocol, and ROS 2 itself."""
_FLATTENED = re.compile(rf"({'|'.join(_FILES + _LIVE)}):/")
_DROPPED_SLASH = re.compile(r"^([A-Za-z][A-Za-z0-9+.-]+):/(?!/)")
_SCHEME = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+)://")


def scheme_of(source: object) -> str:
    """Return what precedes ``://`` in lower case; empty for a path."""
    found = _SCHEME.match(source) if isinstance(source, str) else None
    return found[1].lower() if found else ""


def local_output(path: str | Path, option: str) -> Path:
    """Return the path that is written to.

    Raises:
        UsageError: it is an address, whole or with the slash that a Path drops; `option` names it.
    """
    address = _DROPPED_SLASH.sub(r"\1://", str(path))
    if scheme_of(address):
        raise UsageError(f"An output is a file on this machine; found {option} {without_secrets(address)}.")
    return local_path(path)


def is_live(source: object) -> bool:
    """Return whether this is the address of a running vehicle."""
    return scheme_of(source) in _LIVE


def require_readable(source: str | Path) -> None:
    """Raise UsageError unless a source is a path, or a valid address of a file."""
    scheme = scheme_of(source)
    if isinstance(source, Path) and _FLATTENED.match(str(source)):
        raise UsageError(f"The path {source} was an address, of which a Path drops a slash; give it as a text.")
    if scheme:
        require_valid(str(source))
    if scheme in _LIVE:
        raise UsageError(
            f"{without_secrets(str(source))} is a running vehicle, not a recording; "
            "take a snapshot with `multilica record` first."
        )
    if scheme and scheme not in _FILES:
        raise UsageError(
            f"{without_secrets(str(source))} is an address of an unknown kind; "
            "expected a path, s3://, gs://, https:// or http://."
        )


def require_ros2(address: str) -> None:
    """Raise UsageError unless this is ``ros2://``."""
    if scheme_of(address) != ROS2:
        raise UsageError(f"Found {without_secrets(address)} as the place to publish; expected ros2://.")
    require_valid(address)


def require_valid(url: str) -> None:
    """Raise UsageError unless an address names a host or a bucket, and no impossible port, or ROS 2 alone."""
    scheme = scheme_of(url)
    if scheme == ROS2:
        if url.partition("://")[2]:
            raise UsageError(
                "An address that begins with ros2:// ends there; ROS 2 takes its domain from ROS_DOMAIN_ID and its "
                "middleware from RMW_IMPLEMENTATION."
            )
        return
    try:
        parts = urlsplit(url)
        # Names of buckets may contain colons.
        is_valid = bool(parts.netloc if scheme in _BUCKETS else parts.hostname and parts.port != 0)
    except ValueError:
        is_valid = False
    if not is_valid:
        # Any part of an invalid address may be a password, so it is not shown.
        wanted = f"{scheme}://BUCKET/NAME" if scheme in _BUCKETS else f"{scheme}://HOST or {scheme}://HOST:PORT"
        raise UsageError(f"An address that begins with {scheme}:// is not valid; expected {wanted}.")


def stem_of(source: str | Path) -> str:
    """Return the name of a source without folders and suffix; the host if an address has no path, else its kind."""
    if not scheme_of(source):
        return Path(source).resolve().stem
    parts = urlsplit(str(source))
    return PurePosixPath(parts.path).stem or parts.hostname or parts.scheme


def without_secrets(url: str) -> str:
    """Return the address without user, password, query and fragment."""
    if scheme_of(url) == ROS2:
        return f"{ROS2}://"
    parts = urlsplit(url)
    return f"{parts.scheme}://{parts.netloc.rpartition('@')[2]}{parts.path}"
