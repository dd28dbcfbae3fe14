# SPDX-License-Identifier: Apache-2.0
"""Errors of remote files as one sentence."""

from collections.abc import Iterator
from contextlib import contextmanager

from multilica.errors import MultilicaError, SourceNotFoundError, UnreadableSourceError
from multilica.optional_libraries import raise_missing

_CREDENTIALS = {
    "s3": "set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY or AWS_PROFILE, or FSSPEC_S3_ANON=true for a public bucket",
    "gs": "run `gcloud auth application-default login`, or set FSSPEC_GS_TOKEN=anon for a public bucket",
}
_LIBRARIES = {"s3": "s3fs", "gs": "gcsfs"}
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
_NO_HTTP = {"HttpProcessingError", "BadHttpMessage", "ContentEncodingError"}
_BAD_REDIRECTS = {"InvalidURL", "InvalidUrlClientError", "RedirectClientError"}


class ConnectionLostError(UnreadableSourceError):
    """A server does not answer; trying again may help."""


class WithoutRangesError(UnreadableSourceError):
    """A server does not serve parts of files."""


@contextmanager
def remote_failures_named(where: str, scheme: str) -> Iterator[None]:
    """Turn any error of a client library into one sentence, without its text, which may contain a key."""
    try:
        yield
    except MultilicaError:
        raise
    except ImportError as error:
        raise_missing(f"Reading {where}", _LIBRARIES.get(scheme, "fsspec"), error)
    except Exception as error:
        raise _explained(error, where, scheme) from error


def _explained(error: Exception, where: str, scheme: str) -> MultilicaError:  # noqa: C901, PLR0911 - one per reason
    causes = list(_causes(error))
    # By name, so that no client library is imported to recognise its exceptions.
    names = {kind.__name__ for cause in causes for kind in type(cause).__mro__}
    # A body that ends early has the status of bad HTTP.
    status = None if "ClientPayloadError" in names else _status(causes, names)
    hint = _CREDENTIALS.get(scheme, "check that the address is complete and still valid")
    if "TooManyRedirects" in names:
        return UnreadableSourceError(f"The server of {where} redirects without end; check the address.")
    if names & _BAD_REDIRECTS:
        return UnreadableSourceError(f"The server of {where} redirects to an address that is not valid.")
    if names & _NO_HTTP and not names & _LOST:
        return UnreadableSourceError(f"The server of {where} does not answer in valid HTTP; download the file.")
    if names & _NO_CREDENTIALS:
        return UnreadableSourceError(f"No credentials were found for {where}; {hint}.")
    if status in (401, 403):
        return UnreadableSourceError(f"Access to {where} is denied; {hint}.")
    if status in (404, 410):
        return SourceNotFoundError(f"Nothing exists at {where}.")
    if status is not None:
        return UnreadableSourceError(f"The server of {where} answers with status {status}; try again later.")
    if names & _LATE:
        return ConnectionLostError(f"The server of {where} did not answer in time; try again, or download the file.")
    if names & _LOST:
        return ConnectionLostError(f"The connection to the server of {where} failed; check the address, try again.")
    if any("range requests" in str(cause) for cause in causes):
        return WithoutRangesError(f"The server of {where} does not serve parts of files; download the file.")
    return UnreadableSourceError(f"{where} cannot be read ({type(error).__name__}); try to download the file.")


def _status(causes: list[BaseException], names: set[str]) -> int | None:
    """Return the status of HTTP, also if a client library has raised a built-in exception for it."""
    found = (getattr(cause, name, None) for cause in causes for name in ("status", "code"))
    status = next((code for code in found if isinstance(code, int) and code >= 400), None)
    if status is not None or names & (_LATE | _LOST):
        return status
    return 403 if "PermissionError" in names else 404 if "FileNotFoundError" in names else None


def _causes(error: BaseException) -> Iterator[BaseException]:
    seen: BaseException | None = error
    while seen is not None:
        yield seen
        seen = seen.__cause__
