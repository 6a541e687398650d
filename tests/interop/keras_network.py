"""Trains a network of NVIDIA's kind with tf.keras for a moment, saves it as .h5 and .keras, exports both to ONNX, and answers
pictures with it: a child of checks_models.py, in an environment with requirements-keras.txt.

    keras_network.py DATA OUT

DATA has driving_log.csv and IMG/. OUT gets net.h5, net.keras, h5.onnx, keras.onnx; weights.safetensors, the same weights in
PyTorch's shapes under the names of an nn.Sequential; blocks/, the first 30 pictures as grey blocks, which every JPEG decoder
reads alike; and answers.json: the steering for those blocks, and for the 30 pictures themselves.

Preprocessing and network are those of many solutions of Udacity's project: rows 60 to 134, cv2's INTER_AREA to 200x66, RGB2YUV;
the network normalises itself and takes pictures pixel by pixel.
"""
import csv
import json
import os
import sys
from pathlib import Path

os.environ.update(TF_CPP_MIN_LOG_LEVEL="3", CUDA_VISIBLE_DEVICES="", KERAS_BACKEND="tensorflow")

import cv2
import numpy as np
import tensorflow as tf
from PIL import Image
from safetensors.numpy import save_file
from tensorflow.keras import layers

data, out = map(Path, sys.argv[1:])
with open(data / "driving_log.csv") as log:
    rows = [row for row in csv.reader(log, skipinitialspace=True) if row and not row[0].startswith("center")]


def name(row):
    return Path(row[0].replace("\\", "/")).name


def picture(path):
    rgb = cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB)[60:135]
    return cv2.cvtColor(cv2.resize(rgb, (200, 66), interpolation=cv2.INTER_AREA), cv2.COLOR_RGB2YUV)


def blocks(row, into):
    """A picture as 40 x 20 grey blocks, each a block of the JPEG."""
    small = Image.open(data / "IMG" / name(row)).convert("L").resize((40, 20), Image.Resampling.BOX).convert("RGB")
    small.resize((320, 160), Image.Resampling.NEAREST).save(into / name(row), quality=100, subsampling=0)


pictures = np.stack([picture(data / "IMG" / name(row)) for row in rows]).astype(np.float32)
steering = np.array([float(row[3]) for row in rows], np.float32)

tf.keras.utils.set_random_seed(1)
convolution = lambda filters, side, stride: layers.Conv2D(filters, side, strides=stride, activation="elu")
network = tf.keras.Sequential([
    layers.Input((66, 200, 3)), layers.Rescaling(1 / 127.5, offset=-1),
    convolution(24, 5, 2), convolution(36, 5, 2), convolution(48, 5, 2), convolution(64, 3, 1), convolution(64, 3, 1),
    layers.Flatten(), layers.Dense(100, activation="elu"), layers.Dense(50, activation="elu"), layers.Dense(10, activation="elu"),
    layers.Dense(1),
])
network.compile(optimizer=tf.keras.optimizers.Adam(1e-3), loss="mse")
history = network.fit(pictures, steering, batch_size=32, epochs=4, verbose=0)

network.save(out / "net.h5")
network.save(out / "net.keras")
(out / "blocks/IMG").mkdir(parents=True)
for row in rows[:30]:
    blocks(row, out / "blocks/IMG")
(out / "blocks/driving_log.csv").write_text("".join(f"IMG/{name(row)},,,{row[3]},0.5,0,15\n" for row in rows[:30]))
shown = np.stack([picture(out / "blocks/IMG" / name(row)) for row in rows[:30]]).astype(np.float32)

answers = {}
for kind, file in (("h5", "net.h5"), ("keras", "net.keras")):
    loaded = tf.keras.models.load_model(out / file, compile=False)
    answers[kind] = [float(x) for x in loaded.predict(shown, verbose=0)[:, 0]]
    loaded.export(out / f"{kind}.onnx", format="onnx", verbose=False)
answers["real"] = [float(x) for x in network.predict(pictures[:30], verbose=0)[:, 0]]

weights, place = {}, 0
for layer in network.layers:
    if not layer.weights or layer.name.startswith("rescaling"):
        continue
    kernel, bias = layer.get_weights()
    if kernel.ndim == 4:
        kernel = kernel.transpose(3, 2, 0, 1)  # rows, columns, inputs, outputs to outputs, inputs, rows, columns
    else:
        if kernel.shape[0] == 1152:  # behind Flatten: 18 columns of 64 channels to 64 channels of 18 columns
            kernel = kernel.reshape(18, 64, -1).transpose(1, 0, 2).reshape(1152, -1)
            place += 1
        kernel = kernel.T
    weights |= {f"{place}.weight": np.ascontiguousarray(kernel), f"{place}.bias": bias}
    place += 2
save_file(weights, out / "weights.safetensors")
(out / "answers.json").write_text(json.dumps({"loss": history.history["loss"], "answers": answers}))
