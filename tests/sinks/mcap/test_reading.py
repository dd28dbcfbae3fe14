# SPDX-License-Identifier: Apache-2.0
"""The result document in an MCAP file."""

from __future__ import annotations

import json

import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from multilica.errors import UnreadableSourceError
from multilica.sinks.mcap.messages import McapMessage, MessageSchema, mcap_messages, read_attached_document
from tests.sinks.made_documents import made_document


def write_mcap(path, attachments):
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        for name, data in attachments.items():
            writer.add_attachment(1, 1, name, "application/json", data)
        writer.finish()
    return path


def test_the_document_is_the_attached_result(tmp_path):
    document = made_document()
    files = {"config.toml": b"target = 1", "result.json": json.dumps(document).encode(), "zz.json": b"{}"}
    found = read_attached_document(write_mcap(tmp_path / "result.mcap", files))
    assert found.model_dump(mode="json") == document


def test_a_changed_digit_is_noticed(tmp_path):
    path = write_mcap(tmp_path / "result.mcap", {"result.json": json.dumps(made_document()).encode()})
    content = path.read_bytes()
    assert b"0.8" in content
    path.write_bytes(content.replace(b"0.8", b"0.9", 1))
    with pytest.raises(UnreadableSourceError, match="not a whole MCAP file"):
        read_attached_document(path)


def test_a_file_without_a_result_is_refused(tmp_path):
    path = write_mcap(tmp_path / "drive.mcap", {"other.json": b"{}"})
    with pytest.raises(UnreadableSourceError, match=r"has no result\.json attached"):
        read_attached_document(path)


@pytest.mark.parametrize(("error", "told"), [(ValueError("bad chunk"), "bad chunk"), (EOFError(), "EOFError")])
def test_damage_is_told_by_its_text_or_its_name(tmp_path, monkeypatch, error, told):
    def fail(*arguments, **options):
        del arguments, options
        raise error

    monkeypatch.setattr("multilica.sinks.mcap.messages.SeekingReader", fail)
    path = write_mcap(tmp_path / "result.mcap", {})
    with pytest.raises(UnreadableSourceError, match=rf"not a whole MCAP file that can be read: {told}\.$"):
        read_attached_document(path)


def test_schemas_and_channels_are_registered_once(tmp_path):
    schema, other = (MessageSchema(name, "jsonschema", b"{}", "json") for name in ("a", "b"))
    with (tmp_path / "a.mcap").open("wb") as file, mcap_messages(file, "made") as messages:
        for stamp_ns, (topic, kind) in enumerate((("/x", schema), ("/y", schema), ("/x", schema), ("/z", other))):
            messages.write(McapMessage(topic, kind, b"1", {"of": topic}), stamp_ns)
    with (tmp_path / "a.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "made"
        summary, found = reader.get_summary(), list(reader.iter_messages())
    assert sorted(each.name for each in summary.schemas.values()) == ["a", "b"]
    assert sorted((each.topic, each.metadata["of"]) for each in summary.channels.values()) == [
        (topic, topic) for topic in ("/x", "/y", "/z")
    ]
    assert [(kind.name, channel.topic) for kind, channel, _ in found] == [
        ("a", "/x"), ("a", "/y"), ("a", "/x"), ("b", "/z")
    ]  # fmt: skip
    assert [(each.sequence, each.log_time, each.publish_time) for _, _, each in found] == [(n, n, n) for n in range(4)]
