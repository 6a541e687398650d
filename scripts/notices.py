#!/usr/bin/env python3
"""Writes NOTICES: what the program is linked with, and the licences that ask to come along.

    scripts/notices.py            write it anew, after a change of Cargo.lock
    scripts/notices.py --check    exit 1 if it is not what this script would write; in the gate

Crates come from `cargo tree` for each platform that the program is built on, their texts from the sources that
Cargo has fetched. What is used to build only (procedural macros, build scripts, tests) is not linked and not listed.
Files of others that lie in the repository are those that .gitattributes calls vendored; a README.md beside them begins
with name, version and licence, as in "uPlot 1.6.32 (MIT)".
"""
import json
import re
import subprocess
import sys
import textwrap
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
NOTICES = ROOT / "NOTICES"
TARGETS = ["x86_64-unknown-linux-gnu", "aarch64-unknown-linux-gnu", "aarch64-apple-darwin"]

# C and C++ that crates bring along: where its licence lies in the crate. What follows is not linked by us.
BUNDLED = {
    "openh264-sys2": ("OpenH264", "upstream/LICENSE"),
    "zstd-sys": ("Zstandard", "zstd/LICENSE"),
    "lz4-sys": ("LZ4", "liblz4/lib/LICENSE"),
    "bzip2-sys": ("bzip2", "bzip2-*/LICENSE"),
}

HEAD = """\
Lapwing is licensed under the MIT licence or the Apache licence, version 2.0, as you choose: LICENSE-MIT,
LICENSE-APACHE. The program is linked with the work of others, named here with the licences under which it is used.
Written by scripts/notices.py; whoever passes the program on passes this file on.
"""

LIBTORCH = """\
The program is linked with libtorch, PyTorch's library in C++, which is loaded when it starts and is no part of this
repository: scripts/libtorch.py fetches it from PyTorch's wheel. Its licence (BSD-3-Clause) follows. The wheel
bundles further works (among them oneDNN, XNNPACK, FBGEMM, sleef, Eigen, protobuf; GCC's libgomp and libgfortran
under the GPL with the runtime library exception; on Arm the Compute Library), whose licences the script puts into
.libtorch/licenses. Beside it lie NVIDIA's libcudart and libcupti, which PyTorch's library for the CPU asks for by name;
they are NVIDIA's, under the licence of the CUDA Toolkit. Whoever passes these libraries on passes their licences on.
"""

OPENH264 = """\
Films are encoded by OpenH264, which is compiled from its source into the program (BSD-2-Clause, below). H.264 is
covered by patents. Cisco pays for them only where its own binary of OpenH264 is used as Cisco offers it, which is not
so here: whoever passes the program on for a purpose that needs a licence for the patents must see to it.
"""

IJG = """\
This software is based in part on the work of the Independent JPEG Group. (Pictures are encoded by the crate
jpeg-encoder; its decoder, zune-jpeg, holds none of the Group's code.)
"""

MIT = """\
Permission is hereby granted, free of charge, to any person obtaining a copy of this software and associated
documentation files (the "Software"), to deal in the Software without restriction, including without limitation the
rights to use, copy, modify, merge, publish, distribute, sublicense, and/or sell copies of the Software, and to permit
persons to whom the Software is furnished to do so, subject to the following conditions:

The above copyright notice and this permission notice shall be included in all copies or substantial portions of the
Software.

THE SOFTWARE IS PROVIDED "AS IS", WITHOUT WARRANTY OF ANY KIND, EXPRESS OR IMPLIED, INCLUDING BUT NOT LIMITED TO THE
WARRANTIES OF MERCHANTABILITY, FITNESS FOR A PARTICULAR PURPOSE AND NONINFRINGEMENT. IN NO EVENT SHALL THE AUTHORS OR
COPYRIGHT HOLDERS BE LIABLE FOR ANY CLAIM, DAMAGES OR OTHER LIABILITY, WHETHER IN AN ACTION OF CONTRACT, TORT OR
OTHERWISE, ARISING FROM, OUT OF OR IN CONNECTION WITH THE SOFTWARE OR THE USE OR OTHER DEALINGS IN THE SOFTWARE.
"""


def packages():
    """Everything linked on any of the platforms but Lapwing itself, by name and version."""
    metadata = json.loads(told("metadata", "--format-version=1"))
    known = {(package["name"], package["version"]): package for package in metadata["packages"]}
    # The tree, for `cargo metadata` also lists what a dependency's dependency could be asked for and is not.
    linked = set()
    for target in TARGETS:
        lines = told("tree", "--package=lapwing", "--edges=normal,no-proc-macro", "--prefix=none", f"--target={target}")
        linked |= {tuple(line.split()[:2]) for line in lines.splitlines() if line}
    found = [known[name, version.removeprefix("v")] for name, version in sorted(linked)]
    return [package for package in found if package["source"]]


def told(verb, *arguments):
    """What cargo prints, by Cargo.lock as it is."""
    command = ["cargo", verb, "--locked", *arguments]
    return subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, check=True, text=True).stdout


def chosen(package):
    """The licences that apply: of alternatives the Apache licence where it is one, else MIT, else the first."""
    def pick(alternatives):
        for wanted in ("Apache-2.0", "MIT"):
            if wanted in alternatives:
                return wanted
        return alternatives[0]
    expression = (package["license"] or "").replace("/", " OR ")
    if not expression:
        raise SystemExit(f"notices: {package['name']} names no licence: look at it, then teach this script")
    parts = re.split(r" AND (?![^(]*\))", expression)
    return [pick(part.strip("()").split(" OR ")) for part in parts]


def texts(package, licences):
    """The licence files of a crate, but those of alternatives that were not chosen and Apache's, which we have."""
    folder = Path(package["manifest_path"]).parent
    names = re.compile(r"(?i)^(licen[cs]e|copying|notice|unlicense)")
    files = sorted(path for path in folder.iterdir() if path.is_file() and names.match(path.name))
    wanted = []
    for path in files:
        text = path.read_text(encoding="utf-8", errors="replace").strip()
        if "Apache License" in text and "Version 2.0" in text and not path.name.upper().startswith("NOTICE"):
            continue
        other = [name for name in ("MIT", "BSD", "ZLIB", "UNLICENSE", "0BSD", "CC0") if name in path.name.upper()]
        if other and not any(name in licence.upper() for name in other for licence in licences):
            continue
        if licences == ["Apache-2.0"] and not path.name.upper().startswith("NOTICE"):
            continue
        wanted.append(clean(text))
    if not wanted and licences != ["Apache-2.0"]:
        if licences == ["MIT"]:
            authors = [re.sub(r"\s*<.*", "", author) for author in package["authors"]]
            holders = ", ".join(authors) or f"the authors of {package['name']}"
            wanted.append(f"Copyright (c) {holders}\n\n{MIT.strip()}")
        elif package["name"] not in ("openh264", "openh264-sys2"):  # these are under OpenH264's own, which is here
            raise SystemExit(f"notices: {package['name']} ({licences}) has no licence file: teach this script")
    return wanted


def clean(text):
    """Without trailing spaces and page feeds, so that equal texts are equal."""
    return "\n".join(line.rstrip() for line in text.replace("\f", "").replace("\r\n", "\n").split("\n")).strip()


def vendored():
    """Of each folder with files of others: name, version, licence, and its text."""
    lines = (ROOT / ".gitattributes").read_text(encoding="utf-8").splitlines()
    folders = sorted({Path(line.split()[0]).parent for line in lines if "linguist-vendored" in line.split()})
    for folder in folders:
        found = re.match(r"(\S+) (\S+) \((.+?)\)", (ROOT / folder / "README.md").read_text(encoding="utf-8"))
        if not found:
            raise SystemExit(f"notices: {folder}/README.md does not begin with name, version and (licence)")
        yield *found.groups(), clean((ROOT / folder / "LICENSE").read_text(encoding="utf-8"))


def heading(text):
    return f"\n{'=' * 100}\n{text}\n{'=' * 100}\n"


def notices():
    crates = packages()
    out = [HEAD, heading("libtorch"), LIBTORCH, (ROOT / "scripts/licences/libtorch.txt").read_text().strip() + "\n"]
    out += [heading("OpenH264"), OPENH264, heading("The Independent JPEG Group"), IJG]
    out.append(heading("Crates, and the licences under which they are used"))
    for package in crates:
        out.append(f"{package['name']} {package['version']}: {', '.join(chosen(package))}")
    others = list(vendored())
    out.append("\nFiles of others in the program, and in the pages that it writes:")
    out += [f"{name} {version}: {licence}" for name, version, licence, _ in others]
    out.append("\n" + textwrap.fill("The Apache licence, version 2.0, stands in LICENSE-APACHE. The others follow, "
                                    "each with the crates or files that it comes from.", 100))
    by_text = {}
    for package in crates:
        licences = chosen(package)
        found = texts(package, licences)
        if package["name"] in BUNDLED:
            name, pattern = BUNDLED[package["name"]]
            [path] = Path(package["manifest_path"]).parent.glob(pattern)
            by_text.setdefault(clean(path.read_text(encoding="utf-8")), []).append(f"{name} in {package['name']}")
        for text in found:
            by_text.setdefault(text, []).append(package["name"])
    for name, _, _, text in others:
        by_text.setdefault(text, []).append(name)
    for text, names in by_text.items():
        title = textwrap.fill(", ".join(dict.fromkeys(names)), 100)
        out += [heading(title), text + "\n"]
    return "\n".join(out)


def main():
    wanted = notices()
    if sys.argv[1:] == ["--check"]:
        if not NOTICES.exists() or NOTICES.read_text(encoding="utf-8") != wanted:
            sys.exit("notices: NOTICES is not what Cargo.lock and .gitattributes ask for: run scripts/notices.py and commit it")
    elif sys.argv[1:]:
        sys.exit(__doc__)
    else:
        NOTICES.write_text(wanted, encoding="utf-8")


if __name__ == "__main__":
    main()
