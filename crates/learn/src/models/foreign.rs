//! Files of other tools that are no models to us: what they are, and what to do with them.

use std::path::Path;

/// What to do with weights that PyTorch has pickled.
pub const UNPICKLE: &str = "in Python, safetensors.torch.save_file(state_dict, \"weights.safetensors\") keeps the numbers, \
    then lapwing model rename makes a checkpoint of them; or torch.jit.trace(network, example).save(\"net.pt\") keeps the whole \
    network (docs/how-to/own-network.md)";

/// Of a file or folder that is no model to us: what it is, and what to do.
pub fn advice(path: &Path) -> Option<(&'static str, &'static str)> {
    let tensorflow = "tf2onnx makes an ONNX model of it (docs/how-to/own-network.md)";
    if path.join("saved_model.pb").is_file() {
        return Some(("a TensorFlow SavedModel", tensorflow));
    }
    let extension = path.extension()?.to_str()?.to_lowercase();
    let keras = "in Python, keras.models.load_model(\"IN\").export(\"net.onnx\", format=\"onnx\") makes an ONNX model of it; \
                 write net.toml beside it; then --model net.onnx (docs/how-to/own-network.md)";
    match extension.as_str() {
        "h5" | "hdf5" => Some(("a Keras model in HDF5", keras)),
        "keras" => Some(("a Keras model", keras)),
        "pb" | "tflite" => Some(("a TensorFlow model", tensorflow)),
        "pth" | "ckpt" | "bin" | "pkl" => Some(("weights that PyTorch has pickled", UNPICKLE)),
        "pt2" => {
            Some(("a program of torch.export", "torch.onnx.export(program, f=\"net.onnx\") makes an ONNX model of it"))
        }
        #[cfg(not(feature = "onnx"))]
        "onnx" => Some((
            "an ONNX model, which this build does not read",
            "build with it: cargo build --release --features onnx (docs/how-to/own-network.md)",
        )),
        _ => None,
    }
}
