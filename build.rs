//! Links libtorch so that the binary, the tests and the benches find it at run
//! time with no variable set: an rpath to the folder that torch-sys linked
//! against, and, where that folder is a CUDA build, CUDA itself.

use std::{env, path::Path};

fn main() {
    // Set by torch-sys (`links = "tch"`), which is therefore a direct dependency.
    println!("cargo:rerun-if-env-changed=DEP_TCH_LIBTORCH_LIB");
    if env::var("CARGO_PKG_NAME").is_ok_and(|name| name == "lapwing") && env::var("CARGO_FEATURE_NETWORKS").is_err() {
        return; // built without libtorch
    }
    let Ok(lib) = env::var("DEP_TCH_LIBTORCH_LIB") else {
        println!("cargo:warning=torch-sys did not say where libtorch is; the binary may not start");
        return;
    };
    // First beside the program: `make dist` puts the libraries there, on machines that have no other.
    println!("cargo:rustc-link-arg=-Wl,-rpath,$ORIGIN/lib");
    println!("cargo:rustc-link-arg=-Wl,-rpath,{lib}");
    if Path::new(&lib).join("libtorch_cuda.so").exists() {
        // Nothing names a symbol of libtorch_cuda, so the linker would leave it out.
        println!("cargo:rustc-link-arg=-Wl,--no-as-needed");
        println!("cargo:rustc-link-arg=-ltorch_cuda");
        println!("cargo:rustc-link-arg=-ltorch");
    }
}
