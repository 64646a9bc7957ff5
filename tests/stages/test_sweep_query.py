"""Questions to the table of a campaign: they read that, and nothing else."""

import pytest

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.outputs import sha256_tree
from turtlebag.pipeline.campaign.store import Store
from turtlebag.pipeline.campaign.table import query, write_table


@pytest.mark.parametrize("sql", ["", ";", "-- nothing"])
def test_a_query_that_asks_nothing_is_refused(tmp_path, sql):
    store = Store(str(tmp_path))
    with pytest.raises(InputError, match="not a finished campaign"):
        query(store, "SELECT 1")
    (tmp_path / "sweep.yaml").touch()
    with pytest.raises(InputError, match="not a finished campaign"):
        query(Store(str(tmp_path / "sweep.yaml")), "SELECT 1")
    write_table([{"size": 1, "failed": False}], "failed", store)
    assert query(store, "SELECT size FROM runs") == (["size"], [(1,)])
    with pytest.raises(InputError, match="is empty"):
        query(store, sql)


READING = ["FROM runs", "DESCRIBE runs", "WITH t AS (SELECT 1) SELECT * FROM runs", "SUMMARIZE runs;"]
WRITING = [
    "COPY runs TO '{}'",
    "SELECT 1; COPY runs TO '{}'",
    "ATTACH '{}' AS other",
    "EXPORT DATABASE '{}'",
    "INSTALL httpfs",
    "LOAD parquet",
    "INSERT INTO runs VALUES (2, true)",
    "CREATE TABLE other AS SELECT 1",
    "SET enable_external_access = true",
    "CALL enable_logging(storage = 'file', storage_path = '{}')",
]
REACHING = ["FROM '{}'", "FROM read_text('{}')", "FROM glob('{}')", "FROM read_parquet('{}')", "FROM index"]


def test_a_query_only_reads_and_only_the_table(tmp_path):
    store, aim = Store(str(tmp_path / "store")), tmp_path / "aim.csv"
    write_table([{"size": 1, "failed": False}], "failed", store)
    before = sha256_tree(tmp_path)
    for sql in READING:
        assert query(store, sql)[1]
    for sql in WRITING:
        with pytest.raises(InputError, match=r"^--query: only one SELECT is run"):
            query(store, sql.format(aim))
    assert sha256_tree(tmp_path) == before
    aim.write_text("secret\n")
    for sql in REACHING:
        with pytest.raises(InputError, match=r"^--query: "):
            query(store, sql.format(aim))


@pytest.mark.parametrize(
    ("index", "told"),
    [
        ("[", "not readable JSON"),
        ("{}", "columns: is missing"),
        ('{"columns": {"a": "BIGINT"}, "partition": "b", "files": []}', "partition: b is not a column"),
        (
            '{"columns": {"a": "INT}); COPY (SELECT 1) TO \'x\'"}, "partition": "a", "files": []}',
            "partition: a is not a",
        ),
        ('{"columns": {"a": "BIGINT"}, "partition": "a", "files": ["../other.parquet"]}', "files.0"),
    ],
)
def test_an_index_of_a_table_that_is_none_is_one_line(tmp_path, index, told):
    (tmp_path / "results.json").write_text(index)
    with pytest.raises(InputError, match=rf"results\.json: {told}"):
        query(Store(str(tmp_path)), "SELECT 1")
