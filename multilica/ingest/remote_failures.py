# SPDX-License-Identifier: Apache-2.0
"""What goes wrong with a remote file, as one sentence."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from multilica.errors import MissingDependencyError, MultilicaError, SourceNotFoundError, UnreadableSourceError

__all__ = ["ConnectionLostError", "WithoutRangesError", "remote_failures_named"]

_CREDENTIALS = {
    "s3": "set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY or AWS_PROFILE, or FSSPEC_S3_ANON=true for a public bucket",
    "gs": "run `gcloud auth application-default login`, or set FSSPEC_GS_TOKEN=anon for a public bucket",
}
_EXTRAS = {"s3": "s3", "gs": "gcs"}
_NO_CREDENTIALS = {
    "CredentialRetrievalError",
    "DefaultCredentialsError",
    "NoCredentialsError",
    "PartialCredentialsError",
    "ProfileNotFound",
    "RefreshError",
}
_LATE = {"FSTimeoutError", "TimeoutError", "ConnectTimeoutError", "ReadTimeoutError"}
_LOST = {"ClientConnectionError", "ClientPayloadError", "ConnectionError", "HTTPClientError", "IncompleteReadError"}


class ConnectionLostError(UnreadableSourceError):
    """A server that does not answer, or not any more: trying again may help."""


class WithoutRangesError(UnreadableSourceError):
    """A server that gives whole files only."""


@contextmanager
def remote_failures_named(where: str, scheme: str) -> Iterator[None]:
    """Turn whatever a client library raises into one sentence, which never quotes the library: it may show a key.

    Args:
        where: the address without secrets.
        scheme: what stands before its ``://``.
    """
    try:
        yield
    except MultilicaError:
        raise
    except ImportError as error:
        extra = _EXTRAS.get(scheme, scheme)
        raise MissingDependencyError(
            f"Reading {where} needs a package that is not installed; `pip install 'multilica[{extra}]'` installs it."
        ) from error
    except Exception as error:
        raise _explained(error, where, scheme) from error


def _explained(error: Exception, where: str, scheme: str) -> MultilicaError:
    names, status = _names(error), _status(error)
    if names & _NO_CREDENTIALS:
        return UnreadableSourceError(f"No credentials were found for {where}; {_hint(scheme)}.")
    if status is not None:
        return _refused(status, where, scheme)
    if names & _LATE:
        return ConnectionLostError(f"The server of {where} did not answer in time; try again, or download the file.")
    if names & _LOST:
        return ConnectionLostError(f"The connection to the server of {where} failed; check the address, try again.")
    if any("range requests" in str(cause) for cause in _causes(error)):
        return WithoutRangesError(f"The server of {where} does not serve parts of files; download the file.")
    return UnreadableSourceError(f"{where} cannot be read ({type(error).__name__}); try to download the file.")


def _refused(status: int, where: str, scheme: str) -> MultilicaError:
    if status in (401, 403):
        return UnreadableSourceError(f"Access to {where} is denied; {_hint(scheme)}.")
    if status in (404, 410):
        return SourceNotFoundError(f"Nothing exists at {where}.")
    return UnreadableSourceError(f"The server of {where} answers with status {status}; try again later.")


def _hint(scheme: str) -> str:
    return _CREDENTIALS.get(scheme, "check that the address is complete and still valid")


def _names(error: Exception) -> set[str]:
    """Of the classes, so that no client library is imported to recognise its exceptions."""
    return {kind.__name__ for cause in _causes(error) for kind in type(cause).__mro__}


def _status(error: Exception) -> int | None:
    """Of HTTP, also where a client library has put it into an exception of Python."""
    found = (getattr(cause, name, None) for cause in _causes(error) for name in ("status", "code"))
    status = next((code for code in found if isinstance(code, int) and code >= 400), None)
    names = _names(error)
    if status is not None or names & (_LATE | _LOST):
        return status
    return 403 if "PermissionError" in names else 404 if "FileNotFoundError" in names else None


def _causes(error: BaseException) -> Iterator[BaseException]:
    seen: BaseException | None = error
    while seen is not None:
        yield seen
        seen = seen.__cause__
