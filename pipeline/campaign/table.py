"""Rows of a campaign as one Parquet file, written and asked by DuckDB."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from turtlebag.datasets.errors import InputError


def _duckdb() -> Any:
    try:
        import duckdb
    except ImportError:
        raise InputError("campaigns need DuckDB: run `make setup` again, or pip install duckdb") from None
    return duckdb


def write_parquet(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """One Parquet table of the rows, in their order; columns are the keys of all rows."""
    lines = path.with_suffix(".ndjson")
    columns = list(dict.fromkeys(key for row in rows for key in row))
    with lines.open("w") as file:
        for row in rows:
            file.write(json.dumps({key: row.get(key) for key in columns}) + "\n")
    duckdb = _duckdb()
    connection = duckdb.connect()
    try:
        connection.execute("SET threads = 1")
        source = f"read_json('{_quoted(lines)}', format = 'newline_delimited', sample_size = -1)"
        connection.execute(f"COPY (SELECT * FROM {source}) TO '{_quoted(path)}' (FORMAT parquet)")
    except duckdb.Error as error:
        raise InputError(f"{path}: cannot be written ({str(error).splitlines()[0]})") from None
    finally:
        connection.close()
        lines.unlink()


def query(path: Path, sql: str) -> tuple[list[str], list[tuple[Any, ...]]]:
    """(column names, rows) of a query in which the table is called `runs`; InputError for bad SQL."""
    duckdb = _duckdb()
    connection = duckdb.connect()
    try:
        connection.execute(f"CREATE VIEW runs AS SELECT * FROM read_parquet('{_quoted(path)}')")
        result = connection.execute(sql)
        if result is None or result.description is None:
            raise InputError("query: it is empty; for example: SELECT * FROM runs")
        return [column[0] for column in result.description], result.fetchall()
    except duckdb.Error as error:
        raise InputError(f"query: {str(error).splitlines()[0]}") from None
    finally:
        connection.close()


def _quoted(path: Path) -> str:
    return str(path).replace("'", "''")
