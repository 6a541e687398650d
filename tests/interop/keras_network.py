"""Trains a network of NVIDIA's kind with tf.keras for a moment, saves it as .h5 and .keras, exports both to ONNX, and answers
pictures with it: a child of checks_models.py, in an environment with requirements-keras.txt.

    keras_network.py DATA OUT

DATA has driving_log.csv and IMG/. OUT gets net.h5, net.keras, h5.onnx, keras.onnx, and answers.json: the steering for the first
30 pictures. Preprocessing and network are those of many solutions of Udacity's project: rows 60 to 134, cv2's INTER_AREA to
200x66, RGB2YUV; the network normalises itself and takes pictures pixel by pixel.
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
from tensorflow.keras import layers

data, out = map(Path, sys.argv[1:])
with open(data / "driving_log.csv") as log:
    rows = [row for row in csv.reader(log, skipinitialspace=True) if row and not row[0].startswith("center")]


def picture(row):
    bgr = cv2.imread(str(data / "IMG" / Path(row[0].replace("\\", "/")).name))
    rgb = cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB)[60:135]
    return cv2.cvtColor(cv2.resize(rgb, (200, 66), interpolation=cv2.INTER_AREA), cv2.COLOR_RGB2YUV)


pictures = np.stack([picture(row) for row in rows]).astype(np.float32)
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
answers = {}
for name, file in (("h5", "net.h5"), ("keras", "net.keras")):
    loaded = tf.keras.models.load_model(out / file, compile=False)
    loaded.predict(pictures[:1], verbose=0)  # export wants a network that has been called
    loaded.export(out / f"{name}.onnx", format="onnx", verbose=False)
    answers[name] = [float(x) for x in loaded.predict(pictures[:30], verbose=0)[:, 0]]
(out / "answers.json").write_text(json.dumps({"loss": history.history["loss"], "answers": answers}))
