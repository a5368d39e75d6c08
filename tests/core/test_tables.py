"""Tables: units in the schema, and messages where kind, version or columns are wrong."""

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from thalweg.core import InputError, column, frame_of, read_table, table_kind, write_table
from thalweg.core.tables import kind_of
from thalweg.ingest import schemas

KIND = table_kind(
    "demo",
    2,
    [
        column("t_gps_s", "s", "time"),
        column("n", "1", "count", pa.int32()),
        column("fix", "1", "fix", pa.string()),
    ],
)


def frame():
    return pd.DataFrame({"n": [1, 2], "fix": ["a", "b"], "t_gps_s": [0.5, np.nan]})


def test_round_trip(tmp_path):
    path = tmp_path / "deep" / "a.parquet"
    write_table(path, frame(), KIND, {"origin": [1.5, 2.5]})
    found, meta = read_table(path, KIND)
    assert list(found.columns) == ["t_gps_s", "n", "fix"]
    pd.testing.assert_frame_equal(found, frame()[["t_gps_s", "n", "fix"]], check_dtype=False)
    assert meta == {"origin": [1.5, 2.5]}
    assert found["n"].dtype == np.int32


def test_units_and_meanings_stand_in_the_file(tmp_path):
    write_table(tmp_path / "a.parquet", frame(), KIND)
    schema = pq.read_schema(tmp_path / "a.parquet")
    assert kind_of(schema) == ("demo", 2)
    assert schema.field("t_gps_s").metadata[b"unit"] == b"s"
    assert schema.field("n").metadata == {b"unit": b"1", b"doc": b"count"} | {
        k: v for k, v in schema.field("n").metadata.items() if k.startswith(b"PARQUET")
    }


@pytest.mark.parametrize("kind", [k for k in vars(schemas).values() if isinstance(k, pa.Schema)])
def test_every_reader_table_says_its_units(kind):
    name, version = kind_of(kind)
    assert name
    assert version >= 1
    suffixes = {"_s": "s", "_m": "m", "_deg": "deg", "_rad": "rad", "_mps": "m/s", "_m2": "m^2", "_pa": "Pa"}
    for field in kind:
        assert field.metadata[b"doc"], field.name
        unit = field.metadata[b"unit"].decode()
        for suffix, expected in suffixes.items():
            if field.name.endswith(suffix):
                assert unit == expected, field.name


@pytest.mark.parametrize(
    ("data", "fragment"),
    [
        (frame().drop(columns="n"), r"columns missing: \['n'\], unknown: none"),
        (frame().assign(more=1), r"columns missing: none, unknown: \['more'\]"),
        (frame().assign(n=["x", "y"]), "a column does not fit table kind 'demo'"),
        (frame().assign(n=[1.5, 2.5]), "a column does not fit table kind 'demo'"),
    ],
)
def test_refused_on_writing(tmp_path, data, fragment):
    with pytest.raises(InputError, match=fragment) as caught:
        write_table(tmp_path / "a.parquet", data, KIND)
    assert "a.parquet" in str(caught.value)
    assert not (tmp_path / "a.parquet").exists()


def test_refused_on_reading(tmp_path):
    path = tmp_path / "a.parquet"
    with pytest.raises(InputError, match="file not found"):
        read_table(path, KIND)
    path.write_bytes(b"PAR1 and then rubbish")
    with pytest.raises(InputError, match="not a Parquet file"):
        read_table(path, KIND)
    frame().to_parquet(path)
    with pytest.raises(InputError, match="table kind 'none' version 0; expected 'demo' version 2"):
        read_table(path, KIND)
    older = table_kind("demo", 1, list(KIND))
    write_table(path, frame(), older)
    with pytest.raises(
        InputError, match=r"table kind 'demo' version 1; expected 'demo' version 2.*Rebuild it"
    ):
        read_table(path, KIND)
    fewer = table_kind("demo", 2, list(KIND)[:2])
    write_table(path, frame()[["t_gps_s", "n"]], fewer)
    with pytest.raises(InputError, match=r"columns missing: \['fix'\]"):
        read_table(path, KIND)


def test_frame_of_gives_order_and_types_of_the_kind(tmp_path):
    values = {"fix": np.array(["a", "b"], dtype=object), "n": [1.0, 2.0], "t_gps_s": [1, 2], "more": [0, 0]}
    found = frame_of(KIND, values)
    assert list(found.columns) == ["t_gps_s", "n", "fix"]
    assert [str(t) for t in found.dtypes[:2]] == ["float64", "int32"]
    write_table(tmp_path / "a.parquet", found, KIND)


def test_frame_of_names_what_is_wrong():
    with pytest.raises(InputError, match=r"columns missing: \['n'\].*'demo'"):
        frame_of(KIND, {"fix": ["a"], "t_gps_s": [1.0]})
    with pytest.raises(InputError, match="column 'n' holds no int32"):
        frame_of(KIND, {"fix": ["a"], "t_gps_s": [1.0], "n": ["x"]})
