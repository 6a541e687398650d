"""PyTorch in a virtual environment, without CUDA.

PyPI has one wheel of PyTorch for Linux x86_64. Its libraries ask for CUDA's, which are gigabytes and which nobody uses here. So its
Python is unpacked from that wheel, the one of scripts/libtorch.py; `libtorch_cpu.so` is the one that Lapwing is built with; and one
small library, made here, stands in for all of CUDA's.
"""
import hashlib
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

from bridge import ENVIRONMENT, HERE, REQUIRE_SHARED, ROOT, WORK, Failed, Skipped, install

sys.path.insert(0, str(ROOT / "scripts"))
import libtorch  # noqa: E402

LIBTORCH = Path(os.environ.get("LIBTORCH", ROOT / ".libtorch")).resolve() / "lib"
# Of the wheel's libraries, those that Python needs beside libtorch's own.
WANTED = {f"torch/lib/lib{name}.so" for name in ("torch", "torch_python", "torch_global_deps", "shm", "c10_cuda")}
# Headers and compilers of Protocol Buffers.
UNUSED = ("torch/include/", "torch/bin/protoc")
CUDA = ("libcudnn.so.9", "libcufile.so.0", "libnccl.so.2")


def python():
    """The interpreter of an environment with requirements-torch.txt and PyTorch, made where it is not there yet."""
    requirements, venv = HERE / "requirements-torch.txt", WORK / "venv-torch"
    stamp = hashlib.sha256(requirements.read_bytes() + Path(__file__).read_bytes() + bytes(LIBTORCH)).hexdigest()
    interpreter = venv / "bin" / "python"
    if (venv / stamp).exists():
        return interpreter
    here = platform.system(), platform.machine(), sys.version_info[:2]
    if here != ("Linux", "x86_64", (3, 11)) or not (LIBTORCH / "libcupti.so.13").exists():
        why = "PyTorch without CUDA: expected Python 3.11 on Linux x86_64 and the libtorch of scripts/libtorch.py, got others"
        raise (Failed if REQUIRE_SHARED else Skipped)(why)
    shutil.rmtree(venv, ignore_errors=True)
    install([sys.executable, "-m", "venv", venv])
    install([interpreter, "-m", "pip", "install", "--quiet", "-r", requirements])
    packages = next((venv / "lib").glob("python*/site-packages"))
    unpack(packages)
    for library in LIBTORCH.glob("*.so*"):
        if library.name != "libtorch.so":  # a linker script
            (packages / "torch/lib" / library.name).symlink_to(library)
    stand_in(packages / "torch/lib")
    # Writes the bytecode of what is imported, too, which the checks do not.
    done = subprocess.run([interpreter, "-c", "import torch, torch.onnx, onnxscript; torch.zeros(1).backward"], capture_output=True,
                          text=True, timeout=300, env={k: v for k, v in ENVIRONMENT.items() if k != "PYTHONDONTWRITEBYTECODE"})
    if done.returncode:
        raise Failed(f"import torch: expected exit 0, got {done.returncode}: {done.stderr[-500:]}")
    (venv / stamp).touch()
    return interpreter


def unpack(packages):
    """PyTorch's Python, from the first of the wheels of scripts/libtorch.py."""
    requirement, platforms, sha256, _ = libtorch.PLATFORMS["Linux", "x86_64"]["wheels"][0]
    WORK.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=WORK) as folder:
        try:
            wheel = libtorch.download(requirement, platforms, sha256, Path(folder))
        except libtorch.Failed as why:
            raise Failed(str(why))
        with zipfile.ZipFile(wheel) as archive:
            for name in archive.namelist():
                if name in WANTED or not name.startswith(("torch/lib/lib", *UNUSED)):
                    archive.extract(name, packages)


def symbols(library, kind):
    told = subprocess.run(["nm", "-D", f"--{kind}-only", library], capture_output=True, text=True, check=True).stdout
    return {line.split()[-1].split("@")[0] for line in told.splitlines()}


def stand_in(folder):
    """A library with each symbol that libtorch_python.so asks CUDA for. A function of it does nothing: what is registered with CUDA
    when PyTorch is imported is lost. It returns the address of empty memory; a constructor gives its object a table of functions,
    and a type has a name, since pybind11 looks at them."""
    missing = symbols(folder / "libtorch_python.so", "undefined")
    loaded = subprocess.run(["ldd", folder / "libc10.so"], capture_output=True, text=True, check=True).stdout
    own = [folder / name for name in ("libtorch_cpu.so", "libc10.so", "libc10_cuda.so", "libcudart.so.13", "libshm.so")]
    for library in own + re.findall(r"=> (/\S+)", loaded):
        missing -= symbols(library, "defined")
    missing = sorted(name for name in missing if not re.match("_?Py|_ITM_|__gmon|_ZTH", name))
    types = [name for name in missing if name.startswith("_ZT")]
    constructors = [name for name in missing if re.search("C[12]E", name) and name not in types]
    others = [name for name in missing if name not in types + constructors]
    label = lambda names: "".join(f".globl {name}\n{name}:\n" for name in names)
    lines = [".text", label(constructors), "leaq table+16(%rip), %rax", "movq %rax, (%rdi)", "ret",
             label(others), "nothing:", "leaq empty(%rip), %rax", "ret",
             ".data", ".balign 16", "empty: .zero 4096", "table: .quad 0, type", ".quad nothing\n" * 64,
             "type: .quad 0, name", 'name: .asciz "none"']
    lines += [f'.balign 8\n.globl {name}\n{name}: .quad 0, 1f\n.zero 128\n1: .asciz "{name[4:]}"' for name in types]
    source = folder / "cuda.s"
    source.write_text("\n".join(lines) + '\n.section .note.GNU-stack,"",@progbits\n')
    install(["cc", "-shared", "-nostdlib", "-o", folder / "libtorch_cuda.so", source])
    # Files of these names must be there, and the loader insists on versions in them, which any library built as usual has.
    for name in CUDA:
        (folder / name).symlink_to("libc10.so")
