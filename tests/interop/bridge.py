"""What the checks share: paths, failures that say expected and got, the bridge
and the stand-in simulator as child processes, stock Python and Node packages.

Everything made on the way lies under `target/interop/`: `venv-*` and `node`
are made once and reused, `runs` is emptied at the start of each `run.py`.
"""
import base64
import collections
import functools
import hashlib
import itertools
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
TARGET = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target")).resolve()
LAPWING = TARGET / "release" / "lapwing"
WORK = TARGET / "interop"
RUNS = WORK / "runs"
SHARED = Path(os.environ.get("LAPWING_SHARED", ROOT.parent / "shared")).resolve()
REQUIRE_SHARED = os.environ.get("LAPWING_REQUIRE_SHARED") == "1"
FRAMES = SHARED / "recordings" / "lake" / "IMG"
SHIPPED_RUN = ROOT / "recordings" / "lake.mcap"

# The user's own settings must not change what is measured, nor a proxy stand between.
ENVIRONMENT = {k: v for k, v in os.environ.items() if not k.startswith("LAPWING_")}
ENVIRONMENT.update(no_proxy="127.0.0.1", NO_PROXY="127.0.0.1", PYTHONDONTWRITEBYTECODE="1")


class Failed(Exception):
    """A check that did not hold."""


class Skipped(Exception):
    """A check that cannot be made here."""


def equal(what, got, expected):
    if got != expected:
        raise Failed(f"{what}: expected {expected!r}, got {got!r}")


def within(what, got, low, high=float("inf")):
    if got is None or not low <= got <= high:  # NaN fails, too
        raise Failed(f"{what}: expected {low} to {high}, got {got}")


def wait_for(what, seconds, found):
    """Asks `found` until it is true; returns what it says."""
    end = time.monotonic() + seconds
    while not (it := found()):
        if time.monotonic() > end:
            raise Failed(f"{what}: expected within {seconds} s, got nothing")
        time.sleep(0.02)
    return it


# -- the bridge --------------------------------------------------------------

class Bridge:
    """`lapwing serve` on a free port, or the one given, with its model loaded, as a context. It is
    stopped with SIGINT at the end; `summaries` and `log` are whole then."""

    def __init__(self, *arguments, port=0):
        self.dir = numbered(RUNS)
        runs = () if "--no-recording" in arguments else ("--recordings", self.dir / "mcap")
        self.command = [LAPWING, "serve", "--port", str(port), "--json", *runs, *arguments]
        self.ended = False

    def __enter__(self):
        with open(self.dir / "stdout", "wb") as out, open(self.dir / "stderr", "wb") as err:
            self.process = subprocess.Popen(self.command, cwd=self.dir, env=ENVIRONMENT,
                                            stdin=subprocess.DEVNULL, stdout=out, stderr=err)
        try:
            wait_for("`model:` on stderr", 30, lambda: "model:" in self.log or self.process.poll() is not None)
            if self.process.poll() is not None:
                raise Failed(f"serve: expected to wait for simulators, got exit {self.process.returncode}: {self.log[-300:]}")
            first = self.log.splitlines()[0]
            address = re.match(r"Waiting for a simulator on 127\.0\.0\.1:(\d+)\. ", first)
            if not address:
                raise Failed(f"first line on stderr: expected where Lapwing waits, got {first!r}")
        except BaseException:
            self.kill()
            raise
        self.port = int(address[1])
        return self

    def __exit__(self, kind, *_):
        try:
            if kind is None and not self.ended:
                self.stop()
        finally:
            self.kill()

    @property
    def log(self):
        return (self.dir / "stderr").read_text(errors="replace")

    def said(self):
        """The summaries on stdout so far, whole lines only."""
        lines = (self.dir / "stdout").read_text().splitlines(keepends=True)
        return [json.loads(line) for line in lines if line.endswith("\n")]

    @property
    def recordings(self):
        """The files being recorded or recorded, the oldest first."""
        return sorted((self.dir / "mcap").glob("*"))

    def stop(self, by=signal.SIGINT):
        """Ends the bridge as a person or a service manager would; it must close its runs and exit 0."""
        self.ended = True
        self.process.send_signal(by)
        try:
            equal(f"exit status after {by.name}", self.process.wait(15), 0)
        except subprocess.TimeoutExpired:
            raise Failed(f"expected the bridge to end within 15 s of {by.name}, got none")
        self.summaries = self.said()

    def kill(self):
        """kill -9; nothing where it has ended already."""
        self.ended = True
        self.process.kill()
        self.process.wait()

    def summary(self):
        """Of the only drive there was."""
        equal("summaries on stdout", len(self.summaries), 1)
        return self.summaries[0]


def numbered(folder):
    """A new folder in this one, named by the lowest number that is free."""
    folder.mkdir(parents=True, exist_ok=True)
    for number in itertools.count():
        new = folder / f"{number:02}"
        try:
            new.mkdir()
            return new
        except FileExistsError:
            pass


def resident_mb(pid):
    """Memory that a process holds, as Linux tells it."""
    status = Path(f"/proc/{pid}/status").read_text()
    return next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmRSS")) / 1024


def lapwing(*arguments):
    """A verb that prints JSON; returns it parsed."""
    done = subprocess.run([LAPWING, *map(str, arguments)], cwd=RUNS, env=ENVIRONMENT, capture_output=True, text=True, timeout=120)
    equal(f"exit of lapwing {arguments[0]} ({done.stderr[-300:].strip()})", done.returncode, 0)
    return json.loads(done.stdout)


# -- the stand-in simulator --------------------------------------------------

class Unity:
    """shared/tools/unity_client.py, started at once; `result` waits for its account."""

    def __init__(self, bridge, *arguments):
        command = [sys.executable, SHARED / "tools" / "unity_client.py", "--frames", FRAMES,
                   "--port", bridge.port, *arguments]
        self.process = subprocess.Popen([str(c) for c in command], stdout=subprocess.PIPE,
                                        stderr=subprocess.PIPE, text=True)

    def result(self, timeout=120):
        try:
            out, err = self.process.communicate(timeout=timeout)
        except subprocess.TimeoutExpired:
            self.process.kill()
            raise Failed(f"unity_client.py: expected to end within {timeout} s, got none")
        if not out:
            raise Failed(f"unity_client.py: expected JSON, got exit {self.process.returncode}: {err[-300:]}")
        return json.loads(out)


def unharmed(result, telemetries=None):
    """No answer swallowed, no stall, no death; as many telemetries as asked for, each answered with a command."""
    for what, expected in (("deaths", []), ("stalls", 0), ("lost_tokens", 0)):
        equal(what, result[what], expected)
    if telemetries is not None:
        equal("telemetries", result["telemetries"], telemetries)
        equal("steers", result["steers"], telemetries)
    return f"rtt p50 {result['rtt_p50_ms']} ms, p99 {result['rtt_p99_ms']} ms"


def sent_frames(count):
    """The files that unity_client.py sends, in its order."""
    return sorted(FRAMES.glob("center_*.jpg"))[:count]


# -- stock packages ----------------------------------------------------------

def one_at_a_time(make):
    """`make`, but a second call with the same arguments waits until the first has returned."""
    locks = collections.defaultdict(threading.Lock)

    @functools.wraps(make)
    def waiting(*arguments):
        with locks[arguments]:
            return make(*arguments)
    return waiting


@one_at_a_time
def python(name):
    """The interpreter of a virtual environment with `requirements-NAME.txt`, made where it is not there yet."""
    requirements = HERE / f"requirements-{name}.txt"
    venv, stamp = WORK / f"venv-{name}", hashlib.sha256(requirements.read_bytes()).hexdigest()
    if not (venv / stamp).exists():
        shutil.rmtree(venv, ignore_errors=True)
        # No pip of its own, and no bytecode of modules that are never imported: each takes longer than what is asked for.
        install([sys.executable, "-m", "venv", "--without-pip", venv])
        pip = [sys.executable, "-m", "pip", "--python", venv / "bin" / "python"]
        install([*pip, "install", "--quiet", "--no-compile", "-r", requirements])
        (venv / stamp).touch()
    return venv / "bin" / "python"


@one_at_a_time
def node():
    """The command and the folder of Node with package.json's packages; without Node, the check is skipped or fails."""
    if not shutil.which("node") or not shutil.which("npm"):
        if REQUIRE_SHARED:
            raise Failed("node and npm: expected both on the PATH, got neither or one")
        raise Skipped("node or npm is not on the PATH")
    folder, package = WORK / "node", HERE / "package.json"
    stamp = folder / hashlib.sha256(package.read_bytes()).hexdigest()
    if not stamp.exists():
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        shutil.copy(package, folder)
        install(["npm", "install", "--no-package-lock", "--no-audit", "--no-fund", "--ignore-scripts"], folder)
        stamp.touch()
    return shutil.which("node"), folder


def install(command, cwd=None):
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=300)
    if done.returncode:
        raise Failed(f"{' '.join(map(str, command[:4]))} …: expected exit 0, got {done.returncode}: {done.stderr[-500:]}")


def run_json(command, cwd=None, timeout=60):
    """A helper script in its own environment; returns the JSON that it prints."""
    done = subprocess.run([str(c) for c in command], cwd=cwd, env=ENVIRONMENT, capture_output=True, text=True,
                          timeout=timeout)
    if done.returncode:
        raise Failed(f"{Path(command[1]).name} {' '.join(map(str, command[2:]))}: expected exit 0, "
                     f"got {done.returncode}: {done.stderr.strip()[-500:]}")
    return json.loads(done.stdout)


def read_run(path, *arguments):
    """A run as the stock `mcap` package reads it, see read_run.py."""
    return run_json([python("mcap"), HERE / "read_run.py", path, *arguments])


@one_at_a_time
@functools.lru_cache(maxsize=None)
def jpeg_file():
    """A camera frame: a real one where the shared folder is, else the first of the shipped run."""
    if FRAMES.is_dir():
        return sent_frames(1)[0]
    if not SHIPPED_RUN.exists():
        raise Failed(f"a JPEG: expected {SHIPPED_RUN.relative_to(ROOT)} or the shared folder, got neither")
    frame = WORK / "frame.jpg"
    read_run(SHIPPED_RUN, "--first-frame", frame)
    return frame


def jpeg():
    return jpeg_file().read_bytes()


def telemetry(image=None, **fields):
    """A telemetry's text as the stock build writes it; a field that is None is left out."""
    image = base64.b64encode(jpeg()).decode() if image is None else image
    payload = dict(steering_angle="0.0000", throttle="0.0000", speed="0.0000", image=image)
    payload.update(fields)
    return '42["telemetry",%s]' % json.dumps({k: v for k, v in payload.items() if v is not None}, separators=(",", ":"))
