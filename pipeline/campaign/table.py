"""Rows of a campaign as hive-partitioned Parquet in its store, written and asked by DuckDB.

`results/FACTOR=LEVEL/data_0.parquet`, one file for each level of one factor, and, put last, an index that
names the files and the columns: where it is, the table is whole.
"""

from __future__ import annotations

import json
import re
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.settings import Settings
from turtlebag.datasets.yaml_files import checked
from turtlebag.pipeline.campaign.store import Store, or_else

RESULTS = "results"
INDEX = "results.json"
LOCKED = ("enable_external_access = false", "python_enable_replacements = false", "lock_configuration = true")
"""Settings of DuckDB under which a query reaches nothing but the table: no file, no variable of ours."""

TYPE = re.compile(r'("NULL")|[A-Z][A-Z0-9_ ]*(\(\d+, ?\d+\))?')
"""A type of DuckDB: it becomes part of a statement."""


class Index(Settings):
    """What names the files and the columns of a table, with their types in DuckDB's words."""

    columns: dict[str, str]
    partition: str
    files: list[Annotated[str, Field(pattern=rf"^{RESULTS}/[^/]+=[^/]*/[^/]+\.parquet$")]]


def write_table(rows: Sequence[dict[str, Any]], partition: str, store: Store) -> None:
    """Put the rows into the store, a file for each level of the column `partition`.

    Columns are the keys of all rows. What is left of an earlier table goes.
    """
    import duckdb

    with tempfile.TemporaryDirectory(prefix="turtlebag-") as folder, duckdb.connect() as connection:
        lines, tree = Path(folder, "rows.ndjson"), Path(folder, RESULTS)
        columns = list(dict.fromkeys(key for row in rows for key in row))
        with lines.open("w") as file:
            for row in rows:
                file.write(json.dumps({key: row.get(key) for key in columns}) + "\n")
        source = f"read_json('{_quoted(lines)}', format = 'newline_delimited', sample_size = -1)"
        split = f"FORMAT parquet, PARTITION_BY ({_column(partition)})"
        try:
            connection.execute("SET threads = 1")
            connection.execute(f"CREATE TABLE runs AS SELECT * FROM {source}")
            types = {name: kind for name, kind, *_ in connection.execute("DESCRIBE runs").fetchall()}
            connection.execute(f"COPY runs TO '{_quoted(tree)}' ({split})")
        except duckdb.Error as error:
            raise InputError(
                f"{store.url}: the table cannot be written ({str(error).splitlines()[0]})"
            ) from None
        files = sorted(path for path in tree.rglob("*.parquet"))
        names = [path.relative_to(folder).as_posix() for path in files]
        store.delete(INDEX)
        for name in store.names(RESULTS):
            store.delete(name)
        for name, path in zip(names, files, strict=True):
            store.put(name, path.read_bytes())
        index = {"columns": types, "partition": partition, "files": names}
        store.put(INDEX, (json.dumps(index, indent=2) + "\n").encode())


def query(store: Store, sql: str) -> tuple[list[str], list[tuple[Any, ...]]]:
    """(column names, rows) of a SELECT in which the table is called `runs`, and which can read nothing else;
    InputError for any other SQL, and for a store without a table."""
    import duckdb

    content = None
    with or_else(f"{store.url}: cannot be read"), suppress(NotADirectoryError):
        content = store.read(INDEX)
    if content is None:
        raise InputError(f"{store.url}: not a finished campaign (it has no {INDEX})")
    index = _index(content, f"{store.url}/{INDEX}")
    with duckdb.connect() as connection:
        try:
            _load(connection, store, index)
            for setting in LOCKED:
                connection.execute(f"SET {setting}")
            statements = connection.extract_statements(sql)
            if not statements:
                raise InputError("--query: is empty; for example: SELECT * FROM runs")
            if [statement.type for statement in statements] != [duckdb.StatementType.SELECT]:
                raise InputError("--query: only one SELECT is run; for example: SELECT * FROM runs")
            result = connection.execute(statements[0])
            return [column[0] for column in result.description or ()], result.fetchall()
        except duckdb.Error as error:
            raise InputError(f"--query: {str(error).splitlines()[0]}") from None


def _index(content: bytes, where: str) -> Index:
    try:
        data = json.loads(content)
    except (ValueError, RecursionError):
        raise InputError(f"{where}: not readable JSON") from None
    index = checked(Index, data, where=where)
    if not TYPE.fullmatch(index.columns.get(index.partition, "")):
        raise InputError(f"{where}: partition: {index.partition} is not a column with a type of DuckDB")
    return index


def _load(connection: Any, store: Store, index: Index) -> None:
    """The table `runs` in DuckDB's memory."""
    files = ", ".join(f"'{_quoted(path)}'" for path in _paths(connection, store, index.files))
    part = index.partition
    kind = f"hive_partitioning = true, hive_types = {{{_column(part)}: {index.columns[part]}}}"
    chosen = ", ".join(_column(name) for name in index.columns)
    connection.execute(f"CREATE TABLE runs AS SELECT {chosen} FROM read_parquet([{files}], {kind})")


def _paths(connection: Any, store: Store, names: Sequence[str]) -> list[str]:
    """How DuckDB calls objects of the store; those elsewhere it reads through fsspec, by ranges."""
    paths = [store.at(name) for name in names]
    if store.is_local:
        return paths
    connection.register_filesystem(store.files)
    return [store.files.unstrip_protocol(path) for path in paths]


def _column(name: str) -> str:
    quoted = name.replace('"', '""')
    return f'"{quoted}"'


def _quoted(path: Path | str) -> str:
    return str(path).replace("'", "''")
