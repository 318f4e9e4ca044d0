"""Weights: what is used is what the manifest says, whatever the network and the disk did."""

from __future__ import annotations

import errno
import hashlib
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from sirpy import weights
from sirpy.cli import app
from sirpy.errors import InputError, OutputError, SirpyError
from sirpy.progress import PlainProgress, Progress
from sirpy.weights import download, manifest, weights_file, weights_folder
from typer.testing import CliRunner

ROOT = Path(__file__).parents[2]
PUBLISHED = ROOT.parent / "shared" / "weights" / "params_000007.ckpt"
CONTENT = bytes(range(256)) * 1000


class Answers(BaseHTTPRequestHandler):
    """Each path is another way to answer; `stopped` ends those that do not end by themselves."""

    stopped: threading.Event

    def do_GET(self) -> None:
        with suppress(ConnectionError):
            getattr(self, self.path.strip("/").replace("-", "_"))()

    def log_message(self, *_: object) -> None:
        pass

    def begin(self, **headers: str) -> None:
        self.send_response(200)
        for name, value in headers.items():
            self.send_header(name.replace("_", "-"), value)
        self.end_headers()

    def whole(self) -> None:
        self.begin(Content_Length=str(len(CONTENT)))
        self.wfile.write(CONTENT)

    def moved(self) -> None:
        self.send_response(302)
        self.send_header("Location", "/whole")
        self.end_headers()

    def closed_early(self) -> None:
        self.begin(Content_Length=str(len(CONTENT)))
        self.wfile.write(CONTENT[:1000])

    def closed_within_a_chunk(self) -> None:
        self.protocol_version = "HTTP/1.1"
        self.begin(Transfer_Encoding="chunked")
        self.wfile.write(b"%x\r\n" % len(CONTENT) + CONTENT[:1000])
        self.close_connection = True

    def nothing(self) -> None:
        self.begin(Content_Length="0")

    def endless(self) -> None:
        self.begin()
        while not self.stopped.is_set():
            self.wfile.write(CONTENT)

    def other_bytes(self) -> None:
        self.begin()
        self.wfile.write(CONTENT[:-1] + b"!")

    def stalled(self) -> None:
        self.begin(Content_Length=str(len(CONTENT)))
        self.wfile.write(CONTENT[:1000])
        self.wfile.flush()
        self.stopped.wait()

    def silent(self) -> None:
        self.stopped.wait()

    def no_http(self) -> None:
        self.wfile.write(b"220 mail.example.org\r\n")

    def gone(self) -> None:
        self.send_error(404)


BROKEN = {
    "closed-early": "1,000 of 256,000 bytes",
    "closed-within-a-chunk": "IncompleteRead",
    "nothing": "(0 of 256,000 bytes)",
    "endless": "more than 256,000 bytes",
    "other-bytes": f"instead of {hashlib.sha256(CONTENT).hexdigest()}",
    "stalled": "timed out",
    "silent": "timed out",
    "no-http": "220 mail",
    "gone": "404",
}


@pytest.fixture(scope="module")
def server() -> Iterator[str]:
    """Address of a server of `Answers`."""
    Answers.stopped = threading.Event()
    with ThreadingHTTPServer(("127.0.0.1", 0), Answers) as serving:
        thread = threading.Thread(target=serving.serve_forever, args=(0.01,))
        thread.start()
        yield f"http://127.0.0.1:{serving.server_port}"
        Answers.stopped.set()
        serving.shutdown()
        thread.join()


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Of weights; it is not made yet."""
    monkeypatch.setenv("no_proxy", "*")
    monkeypatch.setenv("SIRPY_WEIGHTS", str(tmp_path / "weights"))
    monkeypatch.setattr(weights, "MANIFEST", tmp_path / "manifest.toml")
    return tmp_path / "weights"


def offer(url: str) -> None:
    """Makes the manifest have one entry, `tiny`, whose file is CONTENT."""
    entry = {
        "what": "Tiny (test)",
        "file": "tiny.ckpt",
        "url": url,
        "size": len(CONTENT),
        "sha256": hashlib.sha256(CONTENT).hexdigest(),
        "licence": "MIT",
        "copyright": "Copyright (c) 2025 Nobody",
        "source": "https://example.org/tiny",
    }
    lines = [f"{key} = {value!r}" for key, value in entry.items()]
    path = weights.MANIFEST
    assert isinstance(path, Path)
    path.write_text("\n".join(["[tiny]", *lines]))


def refused(error: type[SirpyError]) -> str:
    """The sentence that a download of `tiny` ends with."""
    with pytest.raises(error) as caught:
        download("tiny", Progress())
    sentence = str(caught.value)
    assert "\n" not in sentence
    return sentence


@pytest.mark.parametrize("answer", ["whole", "moved"])
def test_a_file_is_downloaded_once(
    server: str, folder: Path, answer: str, capsys: pytest.CaptureFixture[str]
) -> None:
    offer(f"{server}/{answer}")
    path = download("tiny", PlainProgress())
    assert path == folder / "tiny.ckpt" == weights_file("tiny")
    assert path.read_bytes() == CONTENT
    assert "download tiny.ckpt: done, 256 kilobytes" in capsys.readouterr().err
    offer("http://127.0.0.1:9/never-asked")
    assert download("tiny", PlainProgress()) == path
    assert capsys.readouterr().err == f"{path} is there already\n"
    assert list(folder.iterdir()) == [path]


@pytest.mark.parametrize("answer", BROKEN)
def test_a_broken_transfer_leaves_nothing(
    server: str, folder: Path, answer: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(weights, "_TIMEOUT", 0.3)
    offer(f"{server}/{answer}")
    sentence = refused(InputError)
    assert BROKEN[answer] in sentence
    assert f"{server}/{answer}" in sentence
    assert sentence.endswith(f"put the file by hand at {folder / 'tiny.ckpt'}")
    assert not folder.exists()


@pytest.mark.parametrize(
    ("url", "reason"),
    [("http://127.0.0.1:{free}/tiny", "refused"), ("http://nowhere.invalid/tiny", "")],
)
def test_without_a_network_the_sentence_says_where_the_file_goes(
    folder: Path, url: str, reason: str
) -> None:
    with ThreadingHTTPServer(("127.0.0.1", 0), Answers) as closed:
        url = url.format(free=closed.server_port)
    offer(url)
    sentence = refused(InputError)
    assert f"cannot download {url} (" in sentence and reason in sentence
    assert sentence.endswith(f"put the file by hand at {folder / 'tiny.ckpt'}")
    folder.mkdir()
    (folder / "tiny.ckpt").write_bytes(CONTENT)  # as it says
    assert weights_file("tiny").read_bytes() == CONTENT


@pytest.mark.parametrize(
    ("content", "damage"),
    [
        (b"", "0 of 256,000 bytes"),
        (CONTENT[:-1], "255,999 of 256,000 bytes"),
        (CONTENT + b"!", "more than 256,000 bytes"),
        (b"!" + CONTENT[1:], "sha256"),
    ],
)
def test_a_damaged_file_is_never_used(
    server: str, folder: Path, content: bytes, damage: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = folder / "tiny.ckpt"
    folder.mkdir()
    path.write_bytes(content)
    offer(f"{server}/gone")
    with pytest.raises(InputError, match=f"tiny.ckpt is damaged .*{damage}.*weights download tiny"):
        weights_file("tiny")
    refused(InputError)
    assert path.read_bytes() == content  # what is there goes only when something better has come
    offer(f"{server}/whole")
    download("tiny", PlainProgress())
    assert re.search(f"{path} is damaged .*, and is replaced", capsys.readouterr().err)
    assert weights_file("tiny").read_bytes() == CONTENT


def test_what_is_not_there_is_said_with_the_command(folder: Path) -> None:
    offer("http://127.0.0.1:9/never-asked")
    missing = (
        f"tiny.ckpt of tiny is not downloaded to {folder}: run `sirpy weights download tiny`, "
        "or let SIRPY_WEIGHTS name a folder that holds tiny.ckpt"
    )
    with pytest.raises(InputError, match=f"^{re.escape(missing)}$"):
        weights_file("tiny")
    folder.write_text("a file where the folder should be")
    with pytest.raises(InputError, match=f"^{folder}, where weights are looked for, is no folder"):
        weights_file("tiny")
    for refuse in (weights_file, lambda name: download(name, Progress())):
        with pytest.raises(InputError, match="no weights named huge: choose among tiny"):
            refuse("huge")


def test_a_folder_in_the_place_of_the_file_is_one_sentence(server: str, folder: Path) -> None:
    (folder / "tiny.ckpt").mkdir(parents=True)
    offer(f"{server}/whole")
    with pytest.raises(InputError, match=r"tiny.ckpt cannot be read \(Is a directory\)"):
        weights_file("tiny")
    assert "Is a directory" in refused(OutputError)
    assert [path.name for path in folder.iterdir()] == ["tiny.ckpt"]


def test_a_folder_that_cannot_be_written_is_one_sentence(
    server: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    offer(f"{server}/whole")
    folder.write_text("a file where the folder should be")
    sentence = refused(OutputError)
    assert f"cannot write {folder / 'tiny.ckpt'}" in sentence and "SIRPY_WEIGHTS" in sentence
    folder.unlink()

    def read_only(*_: object) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr(Path, "write_bytes", read_only)
    assert "Read-only file system; choose another" in refused(OutputError)
    assert not list(folder.iterdir())


def test_a_disk_that_fills_up_leaves_nothing(
    server: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    offer(f"{server}/whole")

    def full(path: Path, content: bytes) -> None:
        with path.open("wb") as file:
            file.write(content[:100])
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_bytes", full)
    assert "free some space" in refused(OutputError)
    assert not list(folder.iterdir())


DOWNLOAD = """
import sys
from pathlib import Path
from sirpy import weights
from sirpy.progress import PlainProgress
weights.MANIFEST = Path(sys.argv[1])
weights.download("tiny", PlainProgress())
"""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_a_killed_download_leaves_nothing(server: str, folder: Path, number: int) -> None:
    offer(f"{server}/stalled")
    command = [sys.executable, "-c", DOWNLOAD, str(weights.MANIFEST)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr and "256 kilobytes" in process.stderr.readline()
        time.sleep(0.1)  # the first bytes are there, more do not come
        assert process.poll() is None
        process.send_signal(number)
        assert process.wait(10) == -number
    assert not folder.exists() or not list(folder.iterdir())


@pytest.mark.parametrize(
    ("environment", "expected"),
    [
        ({"SIRPY_WEIGHTS": "/mine", "XDG_CACHE_HOME": "/cache"}, "/mine"),
        ({"SIRPY_WEIGHTS": "~/mine"}, "/home/me/mine"),
        ({"SIRPY_WEIGHTS": "", "XDG_CACHE_HOME": "/cache"}, "/cache/sirpy/weights"),
        ({"XDG_CACHE_HOME": "relative"}, "/home/me/.cache/sirpy/weights"),
        ({"XDG_CACHE_HOME": ""}, "/home/me/.cache/sirpy/weights"),
        ({}, "/home/me/.cache/sirpy/weights"),
    ],
)
def test_the_folder(
    environment: dict[str, str], expected: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("SIRPY_WEIGHTS", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    for name, value in {"HOME": "/home/me", **environment}.items():
        monkeypatch.setenv(name, value)
    assert weights_folder() == Path(expected)


def test_a_home_that_nobody_has_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SIRPY_WEIGHTS", "~no-such-user/weights")
    with pytest.raises(InputError, match=r"no folder for weights \(.*let SIRPY_WEIGHTS name one"):
        weights_folder()


def run(*arguments: str) -> str:
    done = CliRunner().invoke(app, ["weights", *arguments])
    if done.exception is not None:
        raise done.exception
    return done.stdout


def test_the_commands(server: str, folder: Path) -> None:
    offer(f"{server}/whole")
    listed = run("list")
    for text in ("tiny: Tiny (test)", "MIT, Copyright", "0.3 MB", "is not downloaded"):
        assert text in listed
    for name in ([], ["tiny"]):
        with pytest.raises(InputError, match="not downloaded"):
            run("verify", *name)
    path = folder / "tiny.ckpt"
    assert run("download", "tiny", "--quiet") == f"weights: {path}\n"
    assert f"file:    {path}\n" in run("list")
    assert run("verify") == run("verify", "tiny") == f"tiny: ok, {path}\n"
    path.write_bytes(b"!")
    assert f"{path} is damaged (1 of 256,000 bytes)" in run("list")
    with pytest.raises(InputError, match="is damaged"):
        run("verify")
    with pytest.raises(InputError, match="no weights named huge"):
        run("verify", "huge")


def test_verify_names_all_that_are_wrong_after_those_that_are_right(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    offer("http://127.0.0.1:9/never-asked")
    path = weights.MANIFEST
    assert isinstance(path, Path)
    tiny = path.read_text()
    others = [tiny.replace("tiny", name) for name in ("lost", "bad")]
    path.write_text("\n".join([*others, tiny]))
    folder.mkdir()
    (folder / "tiny.ckpt").write_bytes(CONTENT)
    (folder / "bad.ckpt").write_bytes(CONTENT[1:])
    done = CliRunner().invoke(app, ["weights", "verify"])
    assert done.stdout == f"tiny: ok, {folder / 'tiny.ckpt'}\n"
    assert isinstance(done.exception, InputError)
    assert "lost.ckpt of lost is not" in str(done.exception)
    assert "bad.ckpt is damaged" in str(done.exception)


def test_the_command_line_ends_with_status_2_and_never_loads_torch(tmp_path: Path) -> None:
    code = "import sys; from sirpy.cli import main\ntry: main()\nfinally: assert 'torch' not in sys.modules"
    done = subprocess.run(
        [sys.executable, "-c", code, "weights", "verify", "patchmatchnet"],
        env={**os.environ, "SIRPY_WEIGHTS": str(tmp_path)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 2
    assert done.stderr.startswith("sirpy: params_000007.ckpt of patchmatchnet is not downloaded")
    assert done.stderr.count("\n") == 1


def test_the_manifest_is_complete_and_sound() -> None:
    entries = manifest().values()
    assert "patchmatchnet" in manifest()
    assert len({entry.file for entry in entries}) == len(entries)
    readme = (ROOT / "third_party" / "README.md").read_text(encoding="utf-8")
    for entry in entries:
        assert Path(entry.file).name == entry.file
        # A commit in the address: what a branch holds may change.
        assert re.fullmatch(rf"https://\S+/[0-9a-f]{{40}}/\S*{re.escape(entry.file)}", entry.url)
        assert entry.source.startswith("https://")
        assert isinstance(entry.size, int) and entry.size > 0
        assert re.fullmatch("[0-9a-f]{64}", entry.sha256)
        assert entry.what and entry.licence and entry.copyright
        row = next(line for line in readme.splitlines() if entry.sha256 in line)
        assert f"`{entry.file}`" in row and f"| {entry.licence} |" in row


def test_third_party_shows_the_manifest_of_the_package() -> None:
    shown = ROOT / "third_party" / "weights.toml"
    assert shown.read_text(encoding="utf-8") == weights.MANIFEST.read_text(encoding="utf-8")


@pytest.mark.skipif(not PUBLISHED.exists(), reason=f"there is no {PUBLISHED}")
def test_the_published_file_is_that_of_the_manifest(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SIRPY_WEIGHTS", str(PUBLISHED.parent))
    assert weights_file("patchmatchnet") == PUBLISHED
