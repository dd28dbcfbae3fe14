# SPDX-License-Identifier: Apache-2.0
"""A bucket on loopback."""

from contextlib import contextmanager

import fsspec

from tests.ingest.support.processes import served


@contextmanager
def bucket(monkeypatch):
    with served("s3_server.py") as port:
        for name, value in {
            "AWS_ENDPOINT_URL": f"http://127.0.0.1:{port}",
            "AWS_ACCESS_KEY_ID": "key",
            "AWS_SECRET_ACCESS_KEY": "secret",
            "AWS_DEFAULT_REGION": "us-east-1",
        }.items():
            monkeypatch.setenv(name, value)
        fsspec.filesystem("s3", skip_instance_cache=True).mkdir("bucket")
        yield "s3://bucket/fleet"
