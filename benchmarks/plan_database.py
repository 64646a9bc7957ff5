"""The OMPL benchmark database (SQLite) that Planner Arena opens: experiments, planners, runs."""

from __future__ import annotations

import sqlite3
from collections.abc import Sequence
from pathlib import Path

# Tables as `ompl_benchmark_statistics` makes them.
SCHEMA = """
CREATE TABLE experiments (id INTEGER PRIMARY KEY AUTOINCREMENT, name VARCHAR(512), totaltime REAL,
  timelimit REAL, memorylimit REAL, runcount INTEGER, version VARCHAR(128), hostname VARCHAR(1024),
  cpuinfo TEXT, date DATETIME, seed INTEGER, setup TEXT);
CREATE TABLE plannerConfigs (id INTEGER PRIMARY KEY AUTOINCREMENT, name VARCHAR(512) NOT NULL, settings TEXT);
CREATE TABLE enums (name VARCHAR(512), value INTEGER, description TEXT, PRIMARY KEY (name, value));
CREATE TABLE runs (id INTEGER PRIMARY KEY AUTOINCREMENT, experimentid INTEGER, plannerid INTEGER,
  time REAL, memory REAL, solved BOOLEAN, correct_solution BOOLEAN, approximate_solution BOOLEAN,
  solution_length REAL, solution_clearance REAL, status INTEGER,
  FOREIGN KEY (experimentid) REFERENCES experiments(id) ON DELETE CASCADE,
  FOREIGN KEY (plannerid) REFERENCES plannerConfigs(id) ON DELETE CASCADE);
CREATE TABLE progress (runid INTEGER, time REAL, PRIMARY KEY (runid, time),
  FOREIGN KEY (runid) REFERENCES runs(id) ON DELETE CASCADE);
"""
STATUS = (
    "Unknown status",
    "Invalid start",
    "Invalid goal",
    "Unrecognized goal type",
    "Timeout",
    "Approximate solution",
    "Exact solution",
)
TIMEOUT, EXACT = 4, 6


def write_database(path: Path, rows: Sequence[dict], version: str, seed: int) -> None:
    """One experiment for each map and query, one planner configuration for each planner."""
    path.unlink(missing_ok=True)
    connection = sqlite3.connect(path)
    with connection:
        connection.executescript(SCHEMA)
        connection.executemany(
            "INSERT INTO enums VALUES ('status', ?, ?)", [(k, text) for k, text in enumerate(STATUS)]
        )
        experiments, planners = {}, {}
        for row in rows:
            name, planner = f"{row['map']} query {row['query']}", row["planner"]
            if name not in experiments:
                experiments[name] = connection.execute(
                    "INSERT INTO experiments (name, totaltime, timelimit, memorylimit, runcount, version, "
                    "hostname, cpuinfo, date, seed, setup) VALUES (?, 0, 0, 0, 1, ?, '', '', '', ?, ?)",
                    (name, version, seed, f"map {row['map']}, robot {row['robot']}"),
                ).lastrowid
            if planner not in planners:
                planners[planner] = connection.execute(
                    "INSERT INTO plannerConfigs (name, settings) VALUES (?, '')", (f"geometric_{planner}",)
                ).lastrowid
            solved = int(row["solved"])
            connection.execute(
                "INSERT INTO runs (experimentid, plannerid, time, memory, solved, correct_solution, "
                "approximate_solution, solution_length, solution_clearance, status) "
                "VALUES (?, ?, ?, 0, ?, ?, 0, ?, ?, ?)",
                (
                    experiments[name],
                    planners[planner],
                    row["time_ms"] / 1e3,
                    solved,
                    solved,
                    row["length_m"] if solved else None,
                    row["clearance_m"] if solved else None,
                    EXACT if solved else TIMEOUT,
                ),
            )
    connection.close()
