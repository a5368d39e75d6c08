"""Parquet tables whose schema carries unit, meaning, kind and format version.

A table kind is a ``pyarrow.Schema``; each field's metadata hold ``unit`` and ``doc``, the schema's own
metadata ``kind`` and ``version``. Writing checks the data against the schema, reading checks the file
against the kind that the caller expects.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from thalweg.core.documents import parse_json, read_json
from thalweg.core.errors import InputError

# ---------------------------------------------------------------- Parquet


_NUMBER = pa.float64()


def column(name: str, unit: str, doc: str, dtype: pa.DataType = _NUMBER) -> "pa.Field[Any]":
    """A column of a table kind: name (with its unit suffix), unit ("1" if none), meaning and type."""
    return pa.field(name, dtype, metadata={"unit": unit, "doc": doc})


def table_kind(kind: str, version: int, columns: "list[pa.Field[Any]]") -> pa.Schema:
    """A table kind from its columns; raise ``version`` whenever a reader of the old form would misread."""
    return pa.schema(columns, metadata={"kind": kind, "version": str(version)})


def kind_of(schema: pa.Schema) -> tuple[str, int]:
    """Kind and format version of a schema; ``("", 0)`` for a foreign one."""
    meta = schema.metadata or {}
    return meta.get(b"kind", b"").decode(), int(meta.get(b"version", b"0"))


def frame_of(schema: pa.Schema, values: Mapping[str, Any], unknown: Any = None) -> pd.DataFrame:
    """DataFrame in the column order and with the types of a table kind.

    Parameters
    ----------
    schema : made by `table_kind`.
    values : (n,) array-like of each column of the kind, or one value for all rows; other keys are left out.
    unknown : value of columns that are not given; None refuses them.

    Raises
    ------
    InputError : a column of the kind has no values, or has values of another type.
    """
    missing = [name for name in schema.names if name not in values]
    kind, _ = kind_of(schema)
    if unknown is not None:
        values = {**dict.fromkeys(missing, unknown), **values}
    elif missing:
        raise InputError(f"columns missing: {missing}", expected=f"the columns of table kind '{kind}'")
    out = {}
    for item in schema:
        value = values[item.name]
        try:
            text = pa.types.is_string(item.type)
            out[item.name] = value if text else np.asarray(value, item.type.to_pandas_dtype())[()]
        except (ValueError, TypeError) as error:
            raise InputError(
                f"column '{item.name}' holds no {item.type} ({error})", expected=f"table kind '{kind}'"
            ) from error
    return pd.DataFrame(out)


def write_table(
    path: Path, frame: pd.DataFrame, schema: pa.Schema, meta: Mapping[str, Any] | None = None
) -> None:
    """Write a table of a documented kind.

    Parameters
    ----------
    path : target, ``.parquet``.
    frame : columns as the schema names them, in any order.
    schema : made by `table_kind`.
    meta : JSON-able facts that belong to the whole table (origin of the frame, source files).

    Raises
    ------
    InputError : columns are missing, unknown, or not convertible.
    """
    kind, _ = kind_of(schema)
    missing = [n for n in schema.names if n not in frame.columns]
    unknown = [n for n in frame.columns if n not in schema.names]
    if missing or unknown:
        raise InputError(
            f"columns missing: {missing or 'none'}, unknown: {unknown or 'none'}",
            expected=f"the columns of table kind '{kind}'",
            where=path,
        )
    try:
        table = pa.Table.from_pandas(
            frame[list(schema.names)], schema=schema, preserve_index=False, safe=True
        )
    except (pa.ArrowInvalid, pa.ArrowTypeError) as error:
        raise InputError(f"a column does not fit table kind '{kind}': {error}", where=path) from error
    metadata = {**(schema.metadata or {}), b"meta": json.dumps(dict(meta or {})).encode()}
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(table.replace_schema_metadata(metadata), path, compression="zstd")


def read_parquet(path: Path) -> pd.DataFrame:
    """Read a Parquet table of any kind.

    Python opens the file: what Arrow opens in C++ is not seen by the check that keeps the truth of the
    digital twin from rules that process (`thalweg.workflow.truth`).

    Raises
    ------
    OSError : the file cannot be opened.
    ValueError : no Parquet (`pyarrow.ArrowInvalid`).
    """
    with path.open("rb") as stream:
        return pd.read_parquet(stream)


def read_table(path: Path, schema: pa.Schema) -> tuple[pd.DataFrame, dict[str, Any]]:
    """Read a table of the expected kind; returns the frame and the facts stored with it.

    Raises
    ------
    InputError : the file is missing, no Parquet, of another kind or of another format version.
    """
    kind, version = kind_of(schema)
    cure = f"Rebuild it with this version of Thalweg (table kind '{kind}', version {version})"
    if not path.is_file():
        raise InputError("file not found", expected=f"a table of kind '{kind}'", where=path)
    try:
        with path.open("rb") as stream:  # not the path: see `read_parquet`
            table = pq.read_table(stream)
    except pa.ArrowInvalid as error:
        raise InputError(f"not a Parquet file ({error})", expected=f"kind '{kind}'", where=path) from error
    found_kind, found_version = kind_of(table.schema)
    if found_kind != kind or found_version != version:
        raise InputError(
            f"table kind '{found_kind or 'none'}' version {found_version}",
            expected=f"'{kind}' version {version}",
            where=path,
            cure=cure,
        )
    missing = [n for n in schema.names if n not in table.column_names]
    if missing:
        raise InputError(f"columns missing: {missing}", where=path, cure=cure)
    meta = parse_json((table.schema.metadata or {}).get(b"meta", b"{}"), path)
    return table.select(list(schema.names)).to_pandas(), meta


# ---------------------------------------------------------------- JSON files between jobs


def write_marked(path: Path, *, kind: str, version: int, content: Mapping[str, Any]) -> None:
    """Write content behind its kind and version; the folder is made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    facts = {"kind": kind, "version": version, **content}
    path.write_text(json.dumps(facts, indent=2) + "\n")


def read_marked(
    path: Path, key: str = "", *, kind: str, version: int, what: str, cure: str
) -> dict[str, Any]:
    """What `write_marked` wrote, or one mapping of it.

    Parameters
    ----------
    path : the file.
    key : name of the mapping in it; by default the whole content, behind its kind and version.
    kind, version : what the file must be.
    what : in words, for messages: "mounts of a campaign".
    cure : how to make the file.

    Raises
    ------
    InputError : the file is missing, no such JSON, or of another kind or version.
    """
    expected = f"{kind}, version {version}"
    facts = read_json(path, what, cure)
    try:
        found, content = (facts["kind"], facts["version"]), dict(facts[key] if key else facts)
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"no {what} ({error!r})", expected=expected, where=path, cure=cure) from error
    if found != (kind, version):
        raise InputError(f"{found[0]}, version {found[1]}", expected=expected, where=path, cure=cure)
    return content
