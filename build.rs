//! Links libtorch so that the binary, the tests and the benches find it at run
//! time with no variable set: an rpath to the folder that torch-sys linked
//! against, and, where that folder is a CUDA build, CUDA itself.
//!
//! The program is told a hash of its sources besides, by which a suite knows the
//! results of another build.

use std::{
    env, fs,
    path::{Path, PathBuf},
};

/// What the program is built from, as far as it is in this package or beside it; `scripts/ci/key.sh` has a list, too.
const SOURCES: [&str; 4] = ["Cargo.lock", "Cargo.toml", "crates", "src"];
/// Endings of the files that belong to it: editors leave others beside them.
const ENDINGS: [&str; 9] = ["css", "html", "jpg", "js", "json", "lock", "pt", "rs", "toml"];

fn main() {
    if env::var("CARGO_PKG_NAME").is_ok_and(|name| name == "lapwing") {
        println!("cargo:rustc-env=LAPWING_SOURCES={:016x}", hash_of_sources());
    }
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

/// A hash (FNV-1a) of the paths and lines of all sources, whatever the system they lie on.
fn hash_of_sources() -> u64 {
    let mut files = vec![];
    for source in SOURCES.map(Path::new).into_iter().filter(|source| source.exists()) {
        println!("cargo:rerun-if-changed={}", source.display());
        collect(source, &mut files);
    }
    files.sort();
    let mut hash = 0xcbf2_9ce4_8422_2325_u64;
    let mut add = |bytes: &[u8]| {
        for byte in bytes.iter().filter(|byte| **byte != b'\r') {
            hash = (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3);
        }
    };
    for file in files {
        let Ok(bytes) = fs::read(&file) else { continue };
        file.iter().for_each(|name| add(&[name.as_encoded_bytes(), b"/"].concat()));
        add(&bytes);
    }
    hash
}

/// Adds the sources of a folder, or the file itself; links are not followed.
fn collect(path: &Path, files: &mut Vec<PathBuf>) {
    let Ok(kind) = path.symlink_metadata() else { return };
    if kind.is_dir() {
        fs::read_dir(path).into_iter().flatten().flatten().for_each(|entry| collect(&entry.path(), files));
    } else if kind.is_file() && path.extension().is_some_and(|ending| ENDINGS.iter().any(|known| ending == *known)) {
        files.push(path.to_owned());
    }
}
