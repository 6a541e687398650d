//! Links libtorch so that the binary, the tests and the benches find it at run
//! time with no variable set: an rpath to the folder that torch-sys linked
//! against, and, where that folder is a CUDA build, CUDA itself.
//!
//! The program is told a hash of its sources besides, by which a suite knows the
//! results of another build.

use std::{
    env, fs,
    hash::{DefaultHasher, Hasher},
    io,
    path::{Path, PathBuf},
};

/// What the program is built from, as far as it is in this package or beside it.
const SOURCES: [&str; 4] = ["Cargo.lock", "Cargo.toml", "crates", "src"];

fn main() {
    if env::var("CARGO_PKG_NAME").is_ok_and(|name| name == "lapwing") {
        let sources = hash_of_sources().expect("the sources of the program can be read");
        println!("cargo:rustc-env=LAPWING_SOURCES={sources:016x}");
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

/// A hash of the paths and bytes of all sources.
fn hash_of_sources() -> io::Result<u64> {
    let mut files = vec![];
    for source in SOURCES.map(Path::new).into_iter().filter(|source| source.exists()) {
        println!("cargo:rerun-if-changed={}", source.display());
        collect(source, &mut files)?;
    }
    files.sort();
    let mut hasher = DefaultHasher::new();
    for file in files {
        hasher.write(file.as_os_str().as_encoded_bytes());
        hasher.write(&fs::read(&file)?);
    }
    Ok(hasher.finish())
}

fn collect(path: &Path, files: &mut Vec<PathBuf>) -> io::Result<()> {
    if !path.is_dir() {
        files.push(path.to_owned());
        return Ok(());
    }
    fs::read_dir(path)?.try_for_each(|entry| collect(&entry?.path(), files))
}
