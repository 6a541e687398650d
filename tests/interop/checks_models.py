"""Networks made elsewhere drive with the answers that they give at home."""
import json
import subprocess
import time

from bridge import ENVIRONMENT, HERE, LAPWING, ROOT, RUNS, Failed, equal, lapwing, python, within

# What the user writes beside the exported network.
SIDE = """outputs = ["steering"]
[preprocess]
crop = { top = 60, bottom = 135 }
resize = { height = 66, width = 200, filter = "cv2-area" }
colour = "cv2-yuv"
scale = "none"
layout = "nhwc"
"""
LAKE = ROOT / "recordings" / "lake.mcap"


def perception(_):
    """The answers that crates/core is tested with are those of the stock packages."""
    done = subprocess.run([python("perception"), HERE / "perception_answers.py"], capture_output=True, text=True, timeout=120)
    equal(f"exit of perception_answers.py ({done.stdout[-300:]}{done.stderr[-300:]})", done.returncode, 0)
    return done.stdout.strip().splitlines()[-1]


def keras(_):
    """A Keras network by .h5, .keras and ONNX, and its weights as PyTorch's."""
    interpreter, work = python("keras"), RUNS / "keras"
    out = work / "out"
    out.mkdir(parents=True)
    lapwing("dataset", "convert", LAKE, work / "data", "--json")
    began = time.monotonic()
    done = subprocess.run([interpreter, HERE / "keras_network.py", work / "data", out], env=dict(ENVIRONMENT, OMP_NUM_THREADS="2"),
                          capture_output=True, text=True, timeout=600)
    equal(f"exit of keras_network.py ({done.stderr[-500:]})", done.returncode, 0)
    trained, told = time.monotonic() - began, json.loads((out / "answers.json").read_text())
    within("the loss after training, against before", told["loss"][-1] / told["loss"][0], 0, 0.5)
    library = next((interpreter.parent.parent / "lib").glob("python*/site-packages/onnxruntime/capi/libonnxruntime.so*"))
    environment = dict(ENVIRONMENT, ORT_DYLIB_PATH=str(library))

    def run(*arguments, code=0, environment=environment):
        done = subprocess.run([LAPWING, *map(str, arguments)], cwd=out, env=environment, capture_output=True, text=True, timeout=120)
        equal(f"exit of lapwing {arguments[0]} ({done.stderr[-400:].strip()})", done.returncode, code)
        return done.stdout + done.stderr

    def apart(model, data, answers):
        run("replay", data, "--model", model, "--write-golden", "answers.golden")
        lines = (out / "answers.golden").read_text().splitlines()[1:31]
        equal("frames", len(lines), 30)
        return max(abs(json.loads(line)["steering"] - answer) for line, answer in zip(lines, answers))

    for kind in ("h5", "keras"):
        (out / f"{kind}.toml").write_text(SIDE)
    (out / "weights.toml").write_text(SIDE.replace('"none"', '"x/127.5-1"').replace("nhwc", "nchw"))
    run("model", "rename", "weights.safetensors", "--network", "pilotnet", "--out", "renamed.safetensors")
    models = {"h5.onnx": "h5", "keras.onnx": "keras", "renamed.safetensors": "keras"}
    worst = {model: apart(model, "blocks", told["answers"][kind]) for model, kind in models.items()}
    for model, off in worst.items():
        within(f"{model}: farthest from Keras' answer to 30 pictures", off, 0, 1e-4)
    # Another JPEG decoder, a level off here and there.
    real = apart("keras.onnx", work / "data", told["answers"]["real"])
    within("with each one's own JPEG decoder", real, 0, 0.02)
    for kind, advice in (("net.h5", "a Keras model in HDF5"), ("net.keras", "a Keras model")):
        if advice not in (said := run("drive", "--model", kind, code=1)):
            raise Failed(f"{kind}: expected to be told what to do, got {said[-300:]}")
    without = {key: value for key, value in environment.items() if key != "ORT_DYLIB_PATH"}
    if "ORT_DYLIB_PATH" not in (said := run("model", "check", "keras.onnx", "--run", LAKE, code=1, environment=without)):
        raise Failed(f"without ONNX Runtime: expected how to get it, got {said[-300:]}")
    checked = json.loads(run("model", "check", "keras.onnx", "--run", LAKE, "--json").split("\n20")[0])
    equal("input", checked["input"], [1, 66, 200, 3])
    driven = run("drive", "--model", "keras.onnx", "--max-time", 5, "--recordings", work / "mcap")
    if "onnx (keras.onnx)" not in driven:
        raise Failed(f"expected a drive by the network, got {driven[-300:]}")
    size = sum(file.stat().st_size for file in interpreter.parent.parent.rglob("*") if file.is_file()) >> 20
    return (f"farthest from Keras {max(worst.values()):.1e} ({', '.join(worst)}), {real:.4f} with each one's JPEG decoder; trained and "
            f"exported in {trained:.0f} s, environment {size} MiB")
