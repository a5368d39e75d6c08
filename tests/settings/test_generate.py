"""The generated files are those of the models, and agree with the campaigns that are shipped."""

import dataclasses
import re

import jsonschema
import pytest

from thalweg.core import parse_yaml, read_yaml
from thalweg.settings import Campaign, write_generated
from thalweg.settings.generate import BEGIN, END, defaults_text, generated, with_manual
from thalweg.settings.messages import all_paths, node_at, schema
from thalweg.settings.sections import Ppk


def test_generated_files_are_in_step(repository):
    for path, text in generated(repository / "config").items():
        there = path.read_text(encoding="utf-8") if path.is_file() else ""
        assert there == text, f"{path} differs from the models: run `thalweg schema --write`"


def test_write_renews_what_differs(tmp_path):
    (tmp_path / "README.md").write_text(f"# Mine\n\n{BEGIN}\nstale text\n{END}\n\nafter\n")
    assert {p.name for p in write_generated(tmp_path)} == {"schema.json", "defaults.yaml", "README.md"}
    assert write_generated(tmp_path) == []
    manual = (tmp_path / "README.md").read_text()
    assert manual.startswith("# Mine\n")
    assert manual.endswith(f"{END}\n\nafter\n")
    assert "stale text" not in manual
    (tmp_path / "schema.json").write_text("{}")
    assert [p.name for p in write_generated(tmp_path)] == ["schema.json"]


def test_manual_is_appended_without_markers():
    assert with_manual("# Mine\n").startswith(f"# Mine\n\n{BEGIN}")


def test_shipped_campaigns_pass_the_json_schema(repository):
    """The schema, as editors use it, accepts what the models accept."""
    validator = jsonschema.Draft202012Validator(schema())
    jsonschema.Draft202012Validator.check_schema(schema())
    for path in (repository / "config" / "campaigns").glob("*.yaml"):
        validator.validate(read_yaml(path).data)


def test_schema_refuses_what_the_models_refuse(repository):
    validator = jsonschema.Draft202012Validator(schema())
    data = read_yaml(repository / "config" / "campaigns" / "tiny.yaml").data
    for section, values in (("lidar", {"model": "x"}), ("qwertz", {}), ("lidar", {"max_range_m": -1})):
        assert not validator.is_valid({**data, section: values})
    del data["twin"]
    assert not validator.is_valid(data)


def test_every_key_is_described():
    for path in all_paths():
        node = node_at(path)
        assert node.get("description"), f"{'.'.join(path)} has no description"


@pytest.mark.parametrize(("suffix", "word"), [("_m", "metres"), ("_s", "seconds"), ("_deg", "degrees")])
def test_units_stand_in_descriptions(suffix, word):
    paths = [path for path in all_paths() if path[-1].endswith(suffix) and "_per_" not in path[-1]]
    assert [".".join(path) for path in paths if word not in node_at(path)["description"]] == []


def test_defaults_hold_every_key_with_its_default(repository):
    document = parse_yaml(defaults_text())
    assert not document.mistakes
    for path in all_paths():
        if path[:3] != ("logs", "gnss", "base_llh") and path[:2] != ("campaign", "origin"):
            assert path in document.lines, ".".join(path)
    expected = Campaign.model_fields["mounts"].default.model_dump(mode="json")
    assert document.data["mounts"] == expected


def test_ppk_section_mirrors_the_options_of_the_engine():
    options = pytest.importorskip("thalweg.ingest.ppk.options").PpkOptions
    defaults = {f.name: f.default for f in dataclasses.fields(options) if not f.name.startswith("base_")}
    assert {name: getattr(Ppk(), name) for name in Ppk.model_fields} == defaults


_ERRORS = re.compile(
    r"ins\.sigma_(roll|pitch|heading)_deg|orientation\.error_model\.(.*_time_s|white_share)"
    r"|lidar_accuracy\.(sigma_component_m|sigma_weak_m|divergence_mrad)"
    r"|fused\.(sigma_velocity_mps|(velocity|attitude|gnss)_time_s|gnss_white_share|sigma_jitter_s)"
)


def test_a_default_of_an_error_names_its_source_or_says_that_there_is_none():
    paths = [path for path in all_paths() if _ERRORS.fullmatch(".".join(path))]
    assert len(paths) == 15
    for path in paths:
        words = node_at(path)["description"]
        assert re.search(r"data sheet|VLP-16|T 2\.2\.1|P2 \d", words), path
