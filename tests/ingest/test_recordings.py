"""Public recordings: downloaded whole or not at all, checked, taken from a mirror; what fails is said."""

import errno
import gc
import hashlib
import io
import re
import shutil
import tarfile
import threading
import warnings
import zipfile
from collections import namedtuple
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
import yaml

from tests.conftest import check_whole
from thalweg.cli import main
from thalweg.core import InputError
from thalweg.ingest import PublicRecording, fetch_recording, public_recordings, recording_named

FILES = {"sub/depths.csv": b"x,y,depth\n1,2,3\n", "log.bin": bytes(range(256)) * 40}


class Origin(SimpleHTTPRequestHandler):
    """Serves a folder; of a file ``cut*`` it sends half of what it promises."""

    asked: list[str]

    def do_GET(self) -> None:
        self.asked.append(self.path)
        if not self.path.startswith("/cut"):
            return super().do_GET()
        whole = Path(self.translate_path(self.path)).read_bytes()
        self.send_response(200)
        self.send_header("Content-Length", str(len(whole)))
        self.end_headers()
        return self.wfile.write(whole[: len(whole) // 2]) and None

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def origin(tmp_path):
    """Address, folder and requests of a server of files."""
    folder = tmp_path / "origin"
    for path, content in {**FILES, "cut.bin": FILES["log.bin"]}.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_bytes(content)
    asked: list[str] = []
    handler = type("Counting", (Origin,), {"asked": asked})
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(handler, directory=folder))
    threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}/", folder, asked
    server.shutdown()
    server.server_close()
    with warnings.catch_warnings():  # pooch leaves the connection of a download that failed to the collector
        warnings.simplefilter("ignore", ResourceWarning)
        gc.collect()


def registered(tmp_path: Path, base: str, files: dict[str, str], **more: object) -> PublicRecording:
    """A recording as a registry states it: texts behind the paths."""
    row = {"what": "two files", "licence": "CC0", "credit": "nobody", "page": "https://x.org", "from": base}
    path = tmp_path / "registry.yaml"
    path.write_text(yaml.safe_dump({"boat/one": {**row, "files": files, **more}}))
    return public_recordings(path)["boat/one"]


def stated(content: bytes, other: str = "") -> str:
    return f"{len(content)} {hashlib.sha256(content).hexdigest()} {other}".strip()


def contents(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_files_are_downloaded_once(tmp_path, origin):
    base, _, asked = origin
    files = {"depths.csv": stated(FILES["sub/depths.csv"], "sub/depths.csv")}
    files["log.bin"] = stated(FILES["log.bin"], f"{base}log.bin")
    recording = registered(tmp_path, f"{base}x/../", files)
    expected = {"depths.csv": FILES["sub/depths.csv"], "log.bin": FILES["log.bin"]}
    for _ in range(2):
        folder = fetch_recording(recording, tmp_path / "mine")
        assert folder == tmp_path / "mine/boat/one"
        assert contents(folder) == expected
        assert asked == ["/sub/depths.csv", "/log.bin"]
    (folder / "log.bin").unlink()  # as if the command had been stopped between two files
    fetch_recording(recording, tmp_path / "mine")
    assert contents(folder) == expected
    assert asked[2:] == ["/log.bin"]


@pytest.mark.parametrize("name", ["all.zip", "all.tar.gz"])
def test_archives_are_unpacked(tmp_path, origin, name):
    base, folder, _ = origin
    if name.endswith(".zip"):
        with zipfile.ZipFile(folder / name, "w") as archive:
            archive.writestr("in/a.txt", b"one")
    else:
        with tarfile.open(folder / name, "w:gz") as archive:
            (entry := tarfile.TarInfo("in/a.txt")).size = 3
            archive.addfile(entry, io.BytesIO(b"one"))
    recording = registered(tmp_path, base, {name: stated((folder / name).read_bytes())}, unpack=True)
    for _ in range(2):  # and once more what somebody has taken away
        got = fetch_recording(recording, tmp_path)
        assert (got / "in/a.txt").read_bytes() == b"one"
        shutil.rmtree(got / "in")


@pytest.mark.parametrize(
    ("path", "text", "message"),
    [
        ("log.bin", stated(b"other"), r"log\.bin: this is another file .* Fetch again"),
        ("none.bin", stated(b"other"), r"status 404.* See whether https://x\.org still has it"),
        ("cut.bin", stated(FILES["log.bin"]), r"could not be downloaded|this is another file"),
        (
            "away.bin",
            stated(b"other", "http://127.0.0.1:9/away.bin"),
            r"ConnectionError.*set THALWEG_DATA to",
        ),
    ],
)
def test_what_goes_wrong_is_said_and_nothing_is_left(tmp_path, origin, path, text, message):
    recording = registered(tmp_path, origin[0], {path: text})
    with pytest.raises(InputError, match=message) as caught:
        fetch_recording(recording, tmp_path)
    assert origin[0] in str(caught.value) or "127.0.0.1:9" in str(caught.value)
    assert contents(tmp_path / "boat") == {}
    check_whole(caught.value)


def test_a_mirror_is_asked_first(tmp_path, origin):
    base, folder, asked = origin
    mirror = tmp_path / "mirror"
    (mirror / "boat/one").mkdir(parents=True)
    shutil.copy(folder / "log.bin", mirror / "boat/one")
    recording = registered(tmp_path, base, {path: stated(content) for path, content in FILES.items()})
    assert contents(fetch_recording(recording, tmp_path / "a", mirror)) == FILES
    assert asked == ["/sub/depths.csv"]
    (mirror / "boat/one/log.bin").write_bytes(b"damaged")
    with pytest.raises(InputError, match=r"another file .* out of the folder THALWEG_DATA") as caught:
        fetch_recording(recording, tmp_path / "b", mirror)
    assert caught.value.where == str(mirror / "boat/one/log.bin")
    # the mirror itself is filled where it lacks something
    (mirror / "boat/one/log.bin").unlink()
    assert contents(fetch_recording(recording, mirror, mirror)) == FILES


def test_a_file_of_the_user_is_not_written_over(tmp_path):
    recording = registered(tmp_path, "http://127.0.0.1:9/", {"log.bin": stated(b"whole")})
    (tmp_path / "boat/one").mkdir(parents=True)
    (tmp_path / "boat/one/log.bin").write_bytes(b"edited")
    with pytest.raises(InputError, match=r"another file than the recording's.* Move it away") as caught:
        fetch_recording(recording, tmp_path)
    check_whole(caught.value)
    assert (tmp_path / "boat/one/log.bin").read_bytes() == b"edited"


def test_a_full_disk(tmp_path, monkeypatch, capsys):
    """Told before the first byte; and where it fills meanwhile, nothing half is left."""
    recording = registered(tmp_path, "http://127.0.0.1:9/", {"log.bin": stated(bytes(2_000_000))})
    Usage = namedtuple("Usage", "free")
    with monkeypatch.context() as patch:
        patch.setattr(shutil, "disk_usage", lambda _: Usage(1_500_000))
        with pytest.raises(InputError, match=r"1\.5 MB are free; expected 2\.0 MB\. Make room") as caught:
            fetch_recording(recording, tmp_path)
        check_whole(caught.value)
    mirror = tmp_path / "mirror/boat/one"
    mirror.mkdir(parents=True)
    (mirror / "log.bin").write_bytes(bytes(2_000_000))

    def full(_, part):
        Path(part).write_bytes(bytes(1000))
        raise OSError(errno.ENOSPC, "No space left on device", part)

    monkeypatch.setattr(shutil, "copyfile", full)
    monkeypatch.setattr("thalweg.ingest.public_recordings", lambda: {"boat/one": recording})
    monkeypatch.setenv("THALWEG_DATA", str(tmp_path / "mirror"))
    assert main(["fetch", "one", "--to", str(tmp_path / "mine")]) == 2
    assert "No space left on device. Make room there" in capsys.readouterr().err
    assert contents(tmp_path / "mine") == {}


def test_the_list_and_a_name_that_is_none(capsys):
    assert main(["fetch"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == len(public_recordings()) + 1
    assert any(re.match(r"river_bottom_interpolator +1,\d\d\d kB  .*sections .*\(MIT\)$", x) for x in lines)
    assert main(["fetch", "lowrance_sl", "anpp_sdk_log"]) == 2
    assert capsys.readouterr().err.endswith("Did you mean lowrance_sl2?\n")
    assert recording_named("lowrance_sl2", public_recordings()).name == "today/lowrance_sl2"


def test_every_row_of_the_registry_can_be_used_by_strangers():
    """An origin that never changes, a licence, somebody to name; no registry of packages, no way out."""
    for recording in public_recordings().values():
        assert recording.licence
        assert recording.credit
        assert recording.page.startswith("https://")
        assert recording.files
        for path, file in recording.files.items():
            assert not Path(path).is_absolute()
            assert ".." not in Path(path).parts
            assert re.fullmatch("[0-9a-f]{64}", file.sha256)
            assert file.size_bytes > 0
            kept = r"https://raw\.githubusercontent\.com/[\w.-]+/[\w.-]+/[0-9a-f]{40}/|https://zenodo\.org/records/\d+/"
            assert re.match(kept, file.address), file.address
            assert "/../" not in file.address
    names = [name.rsplit("/", 1)[-1] for name in public_recordings()]
    assert len(set(names)) == len(names)


@pytest.mark.real
def test_the_recordings_of_the_tests_are_those_of_the_registry(data_dir):
    """Byte by byte, as far as the folder holds them."""
    known = public_recordings().values()
    listed = [
        (Path(data_dir) / each.name / path, file) for each in known for path, file in each.files.items()
    ]
    here = [(path, file) for path, file in listed if path.is_file()]
    assert here
    assert [path for path, file in here if hashlib.sha256(path.read_bytes()).hexdigest() != file.sha256] == []
    assert all(path.stat().st_size == file.size_bytes for path, file in here)


@pytest.mark.real
def test_a_recording_from_the_mirror(data_dir, tmp_path, monkeypatch, capsys):
    log = data_dir / "anpp_sdk_log/Log.anpp"
    assert data_dir / "sbp_piksi_rtk_2017/2017-05-12-v1.1.26.sbp"
    monkeypatch.setenv("THALWEG_DATA", str(data_dir))
    monkeypatch.chdir(tmp_path)
    assert main(["fetch", "anpp_sdk_log", "sbp_piksi_rtk_2017"]) == 0
    said = capsys.readouterr().out
    assert "anpp_sdk_log: 1 files, 47 kB" in said
    assert "not among them: reference/" in said
    assert Path("anpp_sdk_log/Log.anpp").read_bytes() == log.read_bytes()
