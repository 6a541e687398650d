#!/usr/bin/env python3
"""Fetches libtorch into `.libtorch/` of this checkout, once, from PyPI's wheels.

    scripts/libtorch.py            fetch if it is not there yet
    scripts/libtorch.py --force    fetch again
    scripts/libtorch.py --check    only say what is there; exit 1 if nothing is
    scripts/libtorch.py --wheels   only fetch the wheels into LAPWING_WHEELS, see below

Python 3.8 or newer and its pip, nothing else. The wheels' sha256 are pinned
below. All work happens in `.libtorch.partial/`, which is renamed at the very
end: `.libtorch/` is either whole or absent. A libtorch that you already have
needs no fetching: see "Your own libtorch" in the README.

With LAPWING_WHEELS=DIR the wheels stay in DIR, and are taken from there the
next time: tests/interop/pytorch.py needs one of them, too.
"""
import argparse
import fnmatch
import hashlib
import os
import platform
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

VERSION = "2.13.0"  # what tch 0.26 is generated for
ROOT = Path(__file__).resolve().parent.parent
TARGET = ROOT / ".libtorch"
PARTIAL = ROOT / ".libtorch.partial"

# One entry a platform: is it tested, the wheels (requirement, pip platforms,
# sha256, files wanted from it), and the room needed while unpacking. The Linux
# wheels are CUDA builds whose libtorch_cpu.so asks the loader for cudart and
# cupti by name; those two come along and CUDA itself stays out.
CUDA_13 = [
    ("nvidia-cuda-runtime==13.0.96", "libcudart.so.13"),
    ("nvidia-cuda-cupti==13.0.85", "libcupti.so.13"),
]
PLATFORMS = {
    ("Linux", "x86_64"): dict(
        tested=True,
        megabytes=1200,
        wheels=[
            (f"torch=={VERSION}", ["manylinux_2_28_x86_64"],
             "60fcdcb2f3876e21146cb4524ef06397d727ca9ad5f020818547e25075fe3cb7",
             ["torch/lib/libtorch_cpu.so", "torch/lib/libc10.so", "torch/lib/libgomp.so.1"]),
            (CUDA_13[0][0], ["manylinux2014_x86_64", "manylinux_2_17_x86_64"],
             "7f82250d7782aa23b6cfe765ecc7db554bd3c2870c43f3d1821f1d18aebf0548", ["*/" + CUDA_13[0][1]]),
            (CUDA_13[1][0], ["manylinux_2_25_x86_64"],
             "4eb01c08e859bf924d222250d2e8f8b8ff6d3db4721288cf35d14252a4d933c8", ["*/" + CUDA_13[1][1]]),
        ],
        linker_script="INPUT ( libtorch_cpu.so libc10.so )\n",
    ),
    ("Linux", "aarch64"): dict(
        tested=False,
        megabytes=1000,
        wheels=[
            (f"torch=={VERSION}", ["manylinux_2_28_aarch64"],
             "092790c696a760c729fd5722835f50b9d81fd7c8f141571f3f3cf4081a8f664c",
             ["torch/lib/libtorch_cpu.so", "torch/lib/libc10.so", "torch/lib/libgomp.so.1", "torch/lib/libgfortran.so.*",
              "torch/lib/libarm_compute*.so", "torch/lib/libnvpl_*"]),
            (CUDA_13[0][0], ["manylinux2014_aarch64", "manylinux_2_17_aarch64"],
             "ef9bcbe90493a2b9d810e43d249adb3d02e98dd30200d86607d8d02687c43f55", ["*/" + CUDA_13[0][1]]),
            (CUDA_13[1][0], ["manylinux_2_25_aarch64"],
             "796bd679890ee55fb14a94629b698b6db54bcfd833d391d5e94017dd9d7d3151", ["*/" + CUDA_13[1][1]]),
        ],
        linker_script="INPUT ( libtorch_cpu.so libc10.so )\n",
    ),
    ("Darwin", "arm64"): dict(
        tested=False,
        megabytes=700,
        wheels=[
            (f"torch=={VERSION}", ["macosx_14_0_arm64"],
             "e76f9bcecc52b8ff711239a2f7547d5353df95878ab232f0773c1d95928b92f8",
             ["torch/lib/libtorch.dylib", "torch/lib/libtorch_cpu.dylib", "torch/lib/libc10.dylib",
              "torch/lib/libomp.dylib"]),
        ],
        linker_script=None,
    ),
}


class Failed(Exception):
    """A reason in words for the person at the terminal."""


def say(text):
    print(f"libtorch: {text}", file=sys.stderr, flush=True)


def installed():
    """The version in `.libtorch/`, or None where it is absent."""
    try:
        return (TARGET / "build-version").read_text().strip()
    except OSError:
        return None


def download(requirement, pip_platforms, sha256, into):
    """The wheel, in the folder `into`, or in the one that LAPWING_WHEELS names."""
    keep = os.environ.get("LAPWING_WHEELS")
    if keep:
        into = Path(keep).resolve()
        into.mkdir(parents=True, exist_ok=True)
        for wheel in into.glob(requirement.replace("-", "_").replace("==", "-") + "-*.whl"):
            if sha256_of(wheel) == sha256:
                return wheel
            wheel.unlink()
    before = set(into.glob("*.whl"))
    command = [sys.executable, "-m", "pip", "download", "--no-deps", "--only-binary=:all:", "--no-cache-dir",
               "--disable-pip-version-check", "--python-version", "3.11", "--dest", str(into)]
    for name in pip_platforms:
        command += ["--platform", name]
    # pip unpacks nothing here, but downloads into TMPDIR first: /tmp may be a small RAM disk.
    result = subprocess.run(command + [requirement], env=dict(os.environ, TMPDIR=str(into)), stdout=sys.stderr)
    if result.returncode != 0:
        raise Failed(f"pip could not download {requirement} (its own words are above). Is this machine online, "
                     "and does its package index (pip config list) have this version? Then run this again.")
    fresh = sorted(set(into.glob("*.whl")) - before)
    if len(fresh) != 1:
        raise Failed(f"pip said it downloaded {requirement}, but {len(fresh)} new wheels lie in {into}")
    wheel = fresh[0]
    got = sha256_of(wheel)
    if got != sha256:
        raise Failed(f"{wheel.name} is not the file this project was tested with:\n"
                     f"  expected sha256 {sha256}\n       got sha256 {got}\n"
                     "Nothing was installed. Run this again; if it stays so, your package index serves another file.")
    return wheel


def sha256_of(path):
    digest = hashlib.sha256()
    with path.open("rb") as f:
        for block in iter(lambda: f.read(1 << 20), b""):
            digest.update(block)
    return digest.hexdigest()


def unpack(wheel, wanted, into):
    """Copies the wanted libraries to lib/, torch's headers to include/, and the licences of it all to licenses/."""
    with zipfile.ZipFile(wheel) as archive:
        files = [i for i in archive.infolist() if not i.is_dir()]
        chosen = []
        for pattern in wanted:
            hits = [i for i in files if fnmatch.fnmatchcase(i.filename, pattern)]
            if not hits:
                raise Failed(f"{wheel.name} has no file {pattern}: it is not laid out as this script expects")
            chosen += [(i, into / "lib" / Path(i.filename).name) for i in hits]
        chosen += [(i, into / Path(i.filename).relative_to("torch")) for i in files
                   if i.filename.startswith("torch/include/")]
        for info in files:
            package, is_licence, name = info.filename.partition(".dist-info/licenses/")
            if is_licence:
                chosen.append((info, into / "licenses" / package / name))
        total, done, shown = sum(i.file_size for i, _ in chosen), 0, -1
        for info, path in chosen:
            path.parent.mkdir(parents=True, exist_ok=True)
            with archive.open(info) as source, path.open("wb") as sink:
                shutil.copyfileobj(source, sink, 1 << 20)
            done += info.file_size
            percent = 100 * done // max(total, 1)
            if sys.stderr.isatty() and percent != shown:
                shown = percent
                print(f"\rlibtorch: unpacking {wheel.name[:24]} {percent:3d}%", end="", file=sys.stderr, flush=True)
        if sys.stderr.isatty():
            print(file=sys.stderr)


def fetch():
    key = (platform.system(), platform.machine())
    spec = PLATFORMS.get(key)
    if spec is None:
        raise Failed(f"no wheel is known for {key[0]} {key[1]}. Install PyTorch {VERSION} yourself and build with "
                     "LIBTORCH_USE_PYTORCH=1 (README, \"Your own libtorch\").")
    if not spec["tested"]:
        say(f"{key[0]} {key[1]} is untested: it may work, please tell us either way")
    if subprocess.run([sys.executable, "-m", "pip", "--version"], capture_output=True).returncode != 0:
        raise Failed(f"{sys.executable} has no pip. Install it (Debian and Ubuntu: apt install python3-pip; "
                     f"elsewhere: {sys.executable} -m ensurepip) and run this again.")
    free = shutil.disk_usage(ROOT).free >> 20
    if free < spec["megabytes"]:
        raise Failed(f"not enough room in {ROOT}: {spec['megabytes']} MB are needed while unpacking, {free} MB are free")
    shutil.rmtree(PARTIAL, ignore_errors=True)
    wheels = PARTIAL / "wheels"
    wheels.mkdir(parents=True)
    try:
        for number, (requirement, pip_platforms, sha256, wanted) in enumerate(spec["wheels"], 1):
            say(f"{number}/{len(spec['wheels'])} {requirement}")
            wheel = download(requirement, pip_platforms, sha256, wheels)
            unpack(wheel, wanted, PARTIAL)
            if wheel.parent == wheels:
                wheel.unlink()
        if spec["linker_script"]:
            # The wheel's own libtorch.so depends on libtorch_cuda.so; this text file stands in for it at link time.
            (PARTIAL / "lib" / "libtorch.so").write_text(spec["linker_script"])
        shutil.rmtree(wheels)
        (PARTIAL / "build-version").write_text(VERSION + "\n")  # torch-sys checks this file
        shutil.rmtree(TARGET, ignore_errors=True)
        PARTIAL.rename(TARGET)
    except OSError as error:
        raise Failed(f"could not write {error.filename or PARTIAL}: {error.strerror or error}")
    finally:
        shutil.rmtree(PARTIAL, ignore_errors=True)


def fetch_wheels():
    if not os.environ.get("LAPWING_WHEELS"):
        raise Failed("--wheels: expected LAPWING_WHEELS to name the folder for the wheels, got nothing")
    spec = PLATFORMS.get((platform.system(), platform.machine()))
    for requirement, pip_platforms, sha256, _ in spec["wheels"] if spec else ():
        download(requirement, pip_platforms, sha256, None)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--force", action="store_true", help="fetch even if it is there")
    parser.add_argument("--check", action="store_true", help="only say what is there")
    parser.add_argument("--wheels", action="store_true", help="only fetch the wheels into LAPWING_WHEELS")
    arguments = parser.parse_args()
    have = installed()
    if arguments.check:
        say(f"{have} in {TARGET}" if have else f"not in {TARGET}; run {Path(__file__).name}")
        return 0 if have == VERSION else 1
    if have == VERSION and not arguments.force and not arguments.wheels:
        return 0
    try:
        if arguments.wheels:
            fetch_wheels()
            return 0
        fetch()
    except Failed as failure:
        say(f"error: {failure}")
        return 1
    except KeyboardInterrupt:
        say("interrupted; nothing was installed")
        return 130
    say(f"{VERSION} is ready in {TARGET}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
