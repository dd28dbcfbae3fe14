# SPDX-License-Identifier: Apache-2.0
from pathlib import Path

import pytest

from multilica.errors import UnreadableSourceError
from multilica.fleet.store.query import ask, ask_status
from multilica.fleet.store.repair import Repair, repair_store
from multilica.fleet.store.store import open_store
from multilica.fleet.store.upkeep import compact_store
from tests.fleet.support.counted_tasks import Tasks, run, table, write_manifest

FIRST = "s3://logs/v1/0.mcap"


@pytest.fixture
def manifest(tmp_path):
    return write_manifest(tmp_path / "logs.csv")


@pytest.fixture
def store(tmp_path, manifest):
    store = open_store(tmp_path / "store", create=True)
    run(manifest, store, Tasks())
    return store


def part_of(store, source, name):
    with ask(store, "SELECT vehicle, month, key FROM logs WHERE source = ?", [source]) as answer:
        ((vehicle, month, key),) = answer.rows()
    return f"{name}/vehicle={vehicle}/month={month}/{key}.parquet"


def damage(store, path, content=b"no Parquet"):
    Path(store.root, path).write_bytes(content)


def emptied(_):
    return b""


def shortened(content):
    return content[:-100]


def flipped(content):
    return content[:200] + b"\xff" * 8 + content[208:]


@pytest.mark.parametrize("change", [emptied, shortened, flipped])
def test_every_kind_of_damage_is_found_and_set_aside(change, store):
    path = part_of(store, FIRST, "lidars")
    content = change(store.read(path))
    damage(store, path, content)
    with pytest.raises(UnreadableSourceError, match="fleet repair"), ask(store, "FROM lidars") as answer:
        list(answer.rows())
    assert repair_store(store) == Repair((path,), (("v1", FIRST),), 0)
    assert store.read(f"damaged/{path}") == content
    assert repair_store(store) == Repair((), (), 0)


def test_the_next_run_treats_the_named_logs_and_ends_alike(store, manifest):
    before = table(store), table(store, "lidars")
    lidars, logs = part_of(store, FIRST, "lidars"), part_of(store, "s3://logs/v2/1.mcap", "logs")
    damage(store, lidars)
    damage(store, logs)
    done = repair_store(store)
    assert done == Repair((lidars, logs), (("v1", FIRST), ("v2", "s3://logs/v2/1.mcap")), 1)
    run(manifest, store, tasks := Tasks())
    assert sorted(tasks.done) == [source for _, source in done.logs]
    assert (table(store), table(store, "lidars")) == before


@pytest.mark.parametrize("name", ["lidars", "logs"])
def test_logs_of_a_joined_part_are_named(name, store, manifest):
    before = table(store), table(store, "lidars")
    compact_store(store)
    (path,) = (path for path in store.parts(name) if "vehicle=v3/month=2026-01" in path)
    damage(store, path)
    done = repair_store(store)
    assert done.logs == (("v3", "s3://logs/v3/0.mcap"), ("v3", "s3://logs/v3/1.mcap"))
    assert len(table(store)) == len(before[0]) - 2
    run(manifest, store, tasks := Tasks())
    assert sorted(tasks.done) == [source for _, source in done.logs]
    assert (table(store), table(store, "lidars")) == before


def test_the_status_answers_for_the_rest(store):
    answer, damaged = ask_status(store)
    whole = list(answer.rows())
    assert damaged == []
    path = part_of(store, FIRST, "logs")
    damage(store, path)
    answer, damaged = ask_status(store)
    assert damaged == [path]
    rest = list(answer.rows())
    assert [row[1] for row in rest] == [4, 3, 4]
    assert rest[1:] == whole[1:]


def test_a_repair_that_was_killed_goes_on(store, monkeypatch):
    path = part_of(store, FIRST, "lidars")
    damage(store, path)
    monkeypatch.setattr(type(store), "remove", _killed)
    with pytest.raises(InterruptedError):
        repair_store(store)
    monkeypatch.undo()
    assert repair_store(store) == Repair((path,), (("v1", FIRST),), 0)


def _killed(*_):
    raise InterruptedError
