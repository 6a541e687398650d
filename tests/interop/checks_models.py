"""Networks made elsewhere drive with the answers that they give at home."""
import csv
import json
import shutil
import subprocess
import time

import pytorch
from bridge import ENVIRONMENT, HERE, LAPWING, ROOT, RUNS, Failed, equal, lapwing, python, within

# What the user writes beside a network of Keras, and of PyTorch.
SIDE = """outputs = ["steering"]
[preprocess]
crop = { top = 60, bottom = 135 }
resize = { height = 66, width = 200, filter = "cv2-area" }
colour = "cv2-yuv"
scale = "none"
layout = "nhwc"
"""
SIDE_TORCH = SIDE.replace('"none"', '"x/127.5-1"').replace("nhwc", "nchw")
LAKE = ROOT / "recordings" / "lake.mcap"


def perception(_):
    """The answers that crates/core is tested with are those of the stock packages."""
    done = subprocess.run([python("perception"), HERE / "perception_answers.py"], capture_output=True, text=True, timeout=120)
    equal(f"exit of perception_answers.py ({done.stdout[-300:]}{done.stderr[-300:]})", done.returncode, 0)
    return done.stdout.strip().splitlines()[-1]


class Elsewhere:
    """A network that is trained, saved and asked by `NAME_network.py`; `told` is what that says, `answers` what it answers."""

    def __init__(self, name, interpreter):
        self.out, data, decoded = (RUNS / name / part for part in ("out", "data", "decoded"))
        self.interpreter, self.name = interpreter, name
        self.out.mkdir(parents=True)
        library = next((interpreter.parent.parent / "lib").glob("python*/site-packages/onnxruntime/capi/libonnxruntime.so*"))
        self.environment = dict(ENVIRONMENT, ORT_DYLIB_PATH=str(library))
        lapwing("dataset", "convert", LAKE, data, "--json")
        self.run("model", "check", "--run", LAKE, "--pictures", decoded)
        began = time.monotonic()
        done = subprocess.run([interpreter, HERE / f"{name}_network.py", data, decoded, self.out],
                              env=dict(ENVIRONMENT, OMP_NUM_THREADS="2"), capture_output=True, text=True, timeout=600)
        equal(f"exit of {name}_network.py ({done.stderr[-500:]})", done.returncode, 0)
        self.trained_s = time.monotonic() - began
        self.told = json.loads((self.out / "answers.json").read_text())
        self.answers = self.told["answers"]
        within("the loss after training, against before", self.told["loss"][-1] / self.told["loss"][0], 0, 0.5)

    def run(self, *arguments, code=0, environment=None):
        done = subprocess.run([LAPWING, *map(str, arguments)], cwd=self.out, env=environment or self.environment, capture_output=True,
                              text=True, timeout=300)
        said = done.stdout + done.stderr
        equal(f"exit of lapwing {' '.join(map(str, arguments[:3]))} ({said[-600:].strip()})", done.returncode, code)
        return said

    def check(self, model, shape):
        """`lapwing model check` finds nothing wrong; the answers to 100 camera pictures. If some answers were late, another check may
        have taken the processor: it is asked again."""
        folder = f"{model}.answers"
        for left in (2, 1, 0):
            try:
                checked = self.run("model", "check", model, "--run", LAKE, "--pictures", folder, "--json")
                break
            except Failed as failed:
                if left == 0 or "one answer in a hundred takes" not in str(failed):
                    raise
                shutil.rmtree(self.out / folder)
        equal(f"input of {model}", json.JSONDecoder().raw_decode(checked)[0]["input"], shape)
        with open(self.out / folder / "answers.csv") as table:
            here = [float(row["steering"]) for row in csv.DictReader(table)]
        equal("pictures", len(here), 100)
        return here

    def drive(self, model, said):
        driven = self.run("drive", "--model", model, "--max-time", 5, "--recordings", "mcap")
        if f"{said} ({model})" not in driven:
            raise Failed(f"expected a drive by {said} ({model}), got {driven[-300:]}")

    def figures(self, here, home):
        """Whether each model's answers here are near enough to those of its kind at home, and what is said of them."""
        apart = {model: farthest(answers, self.answers[home[model]]) for model, answers in here.items()}
        for model, off in apart.items():
            within(f"{model}: farthest from the answers at home to 100 camera pictures", off, 0, 1e-4)
        own = max(farthest(answers, self.answers["jpeg"]) for answers in here.values())
        within("farthest from them where OpenCV decodes the pictures", own, 0, 0.02)
        decoders = self.told["decoders"]
        size = sum(f.stat().st_size for f in self.interpreter.parent.parent.rglob("*") if f.is_file() and not f.is_symlink()) >> 20
        return (f"farthest from the answers at home to 100 camera pictures {max(apart.values()):.1e} ({', '.join(apart)}); {own:.4f} where "
                f"OpenCV decodes them, which differs in {decoders['differ']:.1%} of the levels by at most {decoders['most']}; trained and "
                f"exported in {self.trained_s:.0f} s, environment {size} MiB")


def farthest(here, home):
    equal("answers", len(here), len(home))
    return max(abs(a - b) for a, b in zip(here, home))


def keras(_):
    """A Keras network by .h5, .keras and ONNX, and its weights as PyTorch's."""
    network = Elsewhere("keras", python("keras"))
    for kind in ("h5", "keras"):
        (network.out / f"{kind}.toml").write_text(SIDE)
    (network.out / "weights.toml").write_text(SIDE_TORCH)
    network.run("model", "rename", "weights.safetensors", "--network", "pilotnet", "--out", "renamed.safetensors")
    nhwc, nchw = [1, 66, 200, 3], [1, 3, 66, 200]
    here = {model: network.check(model, shape) for model, shape in (("h5.onnx", nhwc), ("keras.onnx", nhwc), ("renamed.safetensors", nchw))}
    for kind, advice in (("net.h5", "a Keras model in HDF5"), ("net.keras", "a Keras model")):
        if advice not in (said := network.run("drive", "--model", kind, code=1)):
            raise Failed(f"{kind}: expected to be told what to do, got {said[-300:]}")
    without = {key: value for key, value in network.environment.items() if key != "ORT_DYLIB_PATH"}
    said = network.run("model", "check", "keras.onnx", "--run", LAKE, code=1, environment=without)
    if "ORT_DYLIB_PATH" not in said:
        raise Failed(f"without ONNX Runtime: expected how to get it, got {said[-300:]}")
    network.drive("keras.onnx", "onnx")
    return network.figures(here, {"h5.onnx": "h5", "keras.onnx": "keras", "renamed.safetensors": "keras"})


def torch(_):
    """A PyTorch network by its weights, TorchScript and ONNX."""
    network = Elsewhere("torch", pytorch.python())
    for name in ("weights", "scripted", "traced", "net", "two"):
        (network.out / f"{name}.toml").write_text(SIDE_TORCH)
    said = network.run("model", "rename", "weights.safetensors", "--network", "pilotnet", "--out", "renamed.safetensors")
    if "12.weight                fc1.weight" not in said or "18 tensors" not in said:
        raise Failed(f"expected all tensors under new names, got {said[-300:]}")
    if "external_data=False" not in (said := network.run("model", "check", "two.onnx", "--run", LAKE, code=1)):
        raise Failed(f"two.onnx: expected to be told what to do, got {said[-300:]}")
    models = {"renamed.safetensors": "pilotnet", "scripted.pt": "torchscript", "traced.pt": "torchscript", "net.onnx": "onnx"}
    here = {model: network.check(model, [1, 3, 66, 200]) for model in models}
    for model, kind in models.items():
        network.drive(model, kind)
    return f"PyTorch {network.told['version']}: {network.figures(here, dict.fromkeys(models, 'png'))}"
