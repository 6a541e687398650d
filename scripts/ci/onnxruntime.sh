#!/bin/sh
# A step of action.yml, for models as .onnx alone: installs ONNX Runtime, and names its library to the steps that follow.
set -eu
folder="${RUNNER_TEMP:-/tmp}/onnxruntime"
python3 -m pip install --target "$folder" "onnxruntime>=1.24"
set -- "$folder"/onnxruntime/capi/libonnxruntime.so.1*
if [ ! -f "$1" ]; then
    echo "onnxruntime.sh: expected a libonnxruntime.so.1 in $folder/onnxruntime/capi, found none" >&2
    exit 1
fi
echo "ORT_DYLIB_PATH=$1" >> "$GITHUB_ENV"
