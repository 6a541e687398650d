#!/usr/bin/env python3
"""Packs the program with all libraries that it needs but libc: target/dist/lapwing-VERSION-ARCH-linux.tar.gz.

    scripts/dist.py            pack; `make dist` builds first
    scripts/dist.py --try      pack, unpack into a root with nothing but libc, and drive there
    scripts/dist.py --quick    without compression, to try it

The program looks for libraries in lib/ beside itself first (build.rs), so the folder runs wherever it lies. `--try` needs a
Linux that lets users make namespaces (unshare).
"""
import argparse
import os
import platform
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
TARGET = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
PROGRAM = TARGET / "release" / "lapwing"
# Parts of glibc: the machine's own, or nothing starts.
LIBC = re.compile(r"^(libc|libm|libdl|librt|libpthread|libutil|ld-linux.*|linux-vdso)\.so")
# The documentation, and what its examples and those of --help name.
WITH = ["models/pilotnet.safetensors", "models/pilotnet-first.toml", "models/cps.safetensors", "models/cps.toml",
        "models/lane.safetensors", "models/brake.safetensors", "models/brake-first.toml", "models/brake.toml",
        "models/intersection-ppo.safetensors", "models/intersection-ppo.toml", "models/intersection-maddpg.toml",
        "models/README.md", "recordings/lake.mcap", "recordings/lake.golden",
        "crates/sim/src/track/lake.toml", "crates/sim/src/scenario/ccrs.toml",
        "docs", "README.md", "NOTICES", "LICENSE-MIT", "LICENSE-APACHE"]


def linked(program):
    """Libraries by name, as the loader finds them: all that the program asks for, and what those ask for."""
    told = subprocess.run(["ldd", program], capture_output=True, text=True, check=True).stdout
    found = dict(re.findall(r"^\s*(\S+) => (\S+) ", told, re.M))
    loader = re.search(r"^\s*(/\S*ld-linux\S*) ", told, re.M)
    missing = re.findall(r"^\s*(\S+) => not found", told, re.M)
    if missing:
        sys.exit(f"dist: {program} asks for {', '.join(missing)}, which are not found: make build")
    return found, loader and loader[1]


def gather(folder):
    """Copies the program, its libraries and their licences."""
    found, _ = linked(PROGRAM)
    (folder / "lib").mkdir(parents=True)
    shutil.copy2(PROGRAM, folder / "lapwing")
    for name, path in found.items():
        if not LIBC.match(name):
            shutil.copy2(path, folder / "lib" / name)  # what a link leads to
    torch = Path(found["libtorch_cpu.so"]).parent.parent
    if (torch / "build-version").is_file():
        shutil.copy2(torch / "build-version", folder)  # by which `lapwing doctor` knows it
    if (torch / "licenses").is_dir():
        shutil.copytree(torch / "licenses", folder / "licenses")
    for name in WITH:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (shutil.copytree if (ROOT / name).is_dir() else shutil.copy2)(ROOT / name, folder / name)


def pack(quick):
    version = re.search(r'^version = "(.+)"', (ROOT / "Cargo.toml").read_text(), re.M)[1]
    name = f"lapwing-{version}-{platform.machine()}-{platform.system().lower()}"
    dist = TARGET / "dist"
    shutil.rmtree(dist, ignore_errors=True)
    gather(dist / name)
    archive = dist / (f"{name}.tar" if quick else f"{name}.tar.gz")
    with tarfile.open(archive, "w" if quick else "w:gz", **({} if quick else {"compresslevel": 6})) as tar:
        tar.add(dist / name, name)
    print(f"{archive} ({archive.stat().st_size >> 20} MiB)")
    return archive


def attempt(archive):
    """Unpacks into an empty root with libc alone, and drives there."""
    with tempfile.TemporaryDirectory() as root:
        root = Path(root)
        with tarfile.open(archive) as tar:
            tar.extractall(root / "anywhere", filter="data")
        found, loader = linked(PROGRAM)
        needed = [loader] + [path for name, path in found.items() if LIBC.match(name)]
        for path in needed:
            to = root / path.lstrip("/")
            to.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(path, to)
        for folder in ("proc", "dev", "tmp"):
            (root / folder).mkdir(exist_ok=True)
        program = "/anywhere/" + archive.name.split(".tar")[0] + "/lapwing"
        # The loader reads from /proc where the program lies, to look beside it.
        way = [shutil.which("unshare")] + ([] if os.geteuid() == 0 else ["--map-root-user"])
        way += ["--pid", "--fork", f"--mount-proc={root}/proc"]
        way += [shutil.which("chroot", path="/usr/sbin:/usr/bin:/sbin:/bin"), str(root), program]
        for arguments in (["--version"], ["drive", "--max-time", "5", "--no-recording"], ["doctor"]):
            done = subprocess.run(way + arguments, env={"HOME": "/tmp", "LAPWING_BRIDGE__PORT": "0"}, capture_output=True, text=True)
            print(f"$ lapwing {' '.join(arguments)}\n{(done.stdout + done.stderr).strip()}")
            if done.returncode:
                sys.exit(f"dist: expected exit 0 in a bare root, got {done.returncode}")
        print(f"starts in a root with {len(needed)} files of glibc, /proc and nothing else")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--try", action="store_true", dest="tries", help="and drive in a bare root")
    parser.add_argument("--quick", action="store_true", help="without compression")
    arguments = parser.parse_args()
    if platform.system() != "Linux":
        sys.exit("dist: expected Linux, where the loader looks beside the program; elsewhere nobody tried")
    archive = pack(arguments.quick)
    if arguments.tries:
        attempt(archive)
    return 0


if __name__ == "__main__":
    sys.exit(main())
