"""Results as arrays: columns by name, and paths; as pandas or Arrow on request."""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from turtlebag.datasets import types
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.se2 import Array

if TYPE_CHECKING:
    import pandas
    import pyarrow

EXTRA = "tables"


class Table:
    """Columns of one length by name: `table["time_s"]` is a NumPy array (n,). Unknown numbers are NaN, texts
    are objects."""

    def __init__(self, columns: Mapping[str, ArrayLike]) -> None:
        self.columns: dict[str, NDArray[Any]] = {name: _column(values) for name, values in columns.items()}

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()), ()))

    def __iter__(self) -> Iterator[str]:
        return iter(self.columns)

    def __getitem__(self, name: str) -> NDArray[Any]:
        """A column, (n,); InputError lists the columns if there is none of that name."""
        if name not in self.columns:
            raise InputError(f"no column {name}; the columns are {', '.join(self.columns)}")
        return self.columns[name]

    def __repr__(self) -> str:
        return f"Table of {len(self)} rows: {', '.join(self.columns)}"

    def to_pandas(self) -> pandas.DataFrame:
        """A pandas.DataFrame; InputError names the extra if pandas is not installed."""
        return _extra("pandas").DataFrame(self.columns)

    def to_arrow(self) -> pyarrow.Table:
        """A pyarrow.Table; InputError names the extra if pyarrow is not installed."""
        return _extra("pyarrow").table(self.columns)

    def _repr_html_(self) -> str:
        from turtlebag.api.pictures import table_html

        return table_html(self.columns)


@dataclass(frozen=True, eq=False, repr=False)
class Trajectory(types.Trajectory):
    """Stamped poses: an array (n, 3) of x, y [m] and yaw [rad] in `frame`, with `stamps_ns` (n,)."""

    frame: str = "map"

    @staticmethod
    def of(other: types.Trajectory, frame: str = "map") -> Trajectory:
        """One of our trajectories in this form."""
        return Trajectory(other.stamps_ns, other.poses, frame)

    @property
    def xyt(self) -> Array:
        """x, y [m] and yaw [rad], (n, 3)."""
        return self.poses.xyt

    @property
    def time_s(self) -> Array:
        """Seconds since the first stamp, (n,)."""
        return np.asarray((self.stamps_ns - self.stamps_ns[:1]) * 1e-9, dtype=np.float64)

    @property
    def table(self) -> Table:
        """Columns stamp_ns, x, y, yaw."""
        return Table({"stamp_ns": self.stamps_ns, **dict(zip(("x", "y", "yaw"), self.xyt.T, strict=True))})

    def to_pandas(self) -> pandas.DataFrame:
        """A pandas.DataFrame with the columns of `table`."""
        return self.table.to_pandas()

    def to_arrow(self) -> pyarrow.Table:
        """A pyarrow.Table with the columns of `table`."""
        return self.table.to_arrow()

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self.xyt, dtype=dtype, copy=True if copy else None)

    def __getitem__(self, index: Any) -> NDArray[Any]:
        return self.xyt[index]

    def __repr__(self) -> str:
        return f"Trajectory in {self.frame}: {self}"

    def _repr_html_(self) -> str:
        from turtlebag.api.pictures import card, path_picture

        return card(f"Trajectory in the frame {self.frame}", str(self), {}, path_picture(self))


def _column(values: ArrayLike) -> NDArray[Any]:
    column = np.asarray(values)
    if column.dtype == object and all(isinstance(one, int | float | None) for one in column):
        return np.array([np.nan if one is None else one for one in column], dtype=np.float64)
    return column if column.dtype.kind in "biuf" else column.astype(object)


def _extra(package: str) -> Any:
    """An optional package."""
    try:
        return importlib.import_module(package)
    except ImportError:
        raise InputError(
            f"needs {package}, which is not installed; run: pip install 'turtlebag[{EXTRA}]'"
        ) from None
