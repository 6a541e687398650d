"""Trains a network of NVIDIA's kind with tf.keras for a moment, saves it as .h5 and .keras, exports both to ONNX, and answers
pictures with it: a child of checks_models.py, in an environment with requirements-keras.txt.

    keras_network.py DATA DECODED OUT

DATA has driving_log.csv and IMG/, DECODED its first pictures as `lapwing model check --pictures` writes them. OUT gets net.h5,
net.keras, h5.onnx, keras.onnx; weights.safetensors, the same weights in PyTorch's shapes under the names of an nn.Sequential; and
answers.json: the steering for the pictures in DECODED, and for the same pictures as OpenCV decodes their JPEG files.

The network normalises itself and takes pictures pixel by pixel.
"""
import json
import os
import sys
from pathlib import Path

os.environ.update(TF_CPP_MIN_LOG_LEVEL="3", CUDA_VISIBLE_DEVICES="", KERAS_BACKEND="tensorflow")

import numpy as np
import tensorflow as tf
from safetensors.numpy import save_file
from tensorflow.keras import layers

from camera_pictures import decoded, decoders, rows, yuv

data, pngs, out = Path(sys.argv[1]), decoded(Path(sys.argv[2])), Path(sys.argv[3])
jpegs, steering = zip(*rows(data))
prepared = lambda paths: np.stack([yuv(path) for path in paths]).astype(np.float32)
pictures = prepared(jpegs)

tf.keras.utils.set_random_seed(1)
convolution = lambda filters, side, stride: layers.Conv2D(filters, side, strides=stride, activation="elu")
network = tf.keras.Sequential([
    layers.Input((66, 200, 3)), layers.Rescaling(1 / 127.5, offset=-1),
    convolution(24, 5, 2), convolution(36, 5, 2), convolution(48, 5, 2), convolution(64, 3, 1), convolution(64, 3, 1),
    layers.Flatten(), layers.Dense(100, activation="elu"), layers.Dense(50, activation="elu"), layers.Dense(10, activation="elu"),
    layers.Dense(1),
])
network.compile(optimizer=tf.keras.optimizers.Adam(1e-3), loss="mse")
history = network.fit(pictures, np.array(steering, np.float32), batch_size=32, epochs=4, verbose=0)

network.save(out / "net.h5")
network.save(out / "net.keras")
answers = {}
for kind in ("h5", "keras"):
    loaded = tf.keras.models.load_model(out / f"net.{kind}", compile=False)
    answers[kind] = [float(x) for x in loaded.predict(prepared(pngs), verbose=0)[:, 0]]
    loaded.export(out / f"{kind}.onnx", format="onnx", verbose=False)
answers["jpeg"] = [float(x) for x in network.predict(pictures[:len(pngs)], verbose=0)[:, 0]]

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
told = {"loss": history.history["loss"], "answers": answers, "decoders": decoders(jpegs[:len(pngs)], pngs)}
(out / "answers.json").write_text(json.dumps(told))
