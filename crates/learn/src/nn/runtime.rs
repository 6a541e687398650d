//! The libtorch that this program runs on.

use std::{fmt, fs, path::Path};

use serde::Serialize;

/// The version that tch's bindings are generated for.
pub const WANTED: &str = "2.13.0";

/// What is known about the libtorch in use.
#[derive(Debug, Clone, Serialize)]
pub struct Libtorch {
    /// Its version, if its folder says.
    pub version: Option<String>,
    /// The loaded file, if the system reports it.
    pub file: Option<String>,
    /// Whether CUDA can be used, and with how many devices.
    pub cuda_devices: u32,
    /// Threads for one operation.
    pub threads: u32,
    /// Processors of this machine.
    pub cores: u32,
}

/// Looks at the libtorch in use.
pub fn libtorch() -> Libtorch {
    let file = loaded_file();
    let version = file.as_deref().and_then(|file| version_beside(Path::new(file)));
    Libtorch {
        version,
        file,
        cuda_devices: if tch::Cuda::is_available() { u32::try_from(tch::Cuda::device_count()).unwrap_or(0) } else { 0 },
        threads: u32::try_from(tch::get_num_threads()).unwrap_or(0),
        cores: std::thread::available_parallelism().map_or(1, |n| u32::try_from(n.get()).unwrap_or(1)),
    }
}

/// The processor, by name if the system reports it, and its vector width: libtorch chooses its kernels by that, and
/// they round differently.
pub fn processor() -> String {
    // Virtual machines often report only a maker's name, and Linux on ARM none at all.
    let told = fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name = told.lines().find(|line| line.starts_with("model name")).and_then(|line| line.split_once(':'));
    let name = name.map_or("a processor without a name", |(_, name)| name.trim());
    #[cfg(target_arch = "x86_64")]
    let width = match () {
        () if std::arch::is_x86_feature_detected!("avx512f") => ", AVX-512",
        () if std::arch::is_x86_feature_detected!("avx2") => ", AVX2",
        () => "",
    };
    #[cfg(not(target_arch = "x86_64"))]
    let width = "";
    format!("{name} ({}{width})", std::env::consts::ARCH)
}

/// Threads for one operation, from now on.
pub fn set_threads(threads: u16) {
    tch::set_num_threads(i32::from(threads.max(1)));
}

/// Whether this processor multiplies bf16 itself. If not, libtorch emulates it, many times slower than f32: 37 instead
/// of 700 pictures a second in training PilotNet on a Xeon with AVX512 alone.
pub fn knows_bf16() -> bool {
    #[cfg(target_arch = "x86_64")]
    return std::arch::is_x86_feature_detected!("avx512bf16");
    #[cfg(target_arch = "aarch64")]
    return std::arch::is_aarch64_feature_detected!("bf16");
    #[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
    false
}

/// Keeps glibc from returning tensor memory to the system after every operation and faulting it in again at the next: a
/// quarter less time for PilotNet, 5 ms of 60 for ResNet50. Each arena keeps memory, so there are only as many as
/// threads that can run at once, not eight times as many: with those, a bridge keeps growing for hours, until each
/// arena has reached its maximum. Call this once, at the start of a program.
pub fn keep_tensor_memory() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    {
        let arenas = std::thread::available_parallelism().map_or(2, |cores| cores.get().clamp(2, 1024) as i32);
        // SAFETY: mallopt only changes the allocator's settings, and glibc's takes its own lock for it.
        unsafe {
            libc::mallopt(libc::M_TRIM_THRESHOLD, i32::MAX);
            libc::mallopt(libc::M_MMAP_THRESHOLD, i32::MAX);
            libc::mallopt(libc::M_TOP_PAD, 64 << 20);
            libc::mallopt(libc::M_ARENA_MAX, arenas);
        }
    }
}

impl Libtorch {
    /// What is wrong with it, in words.
    pub fn troubles(&self) -> Vec<String> {
        let mut troubles = vec![];
        match &self.version {
            Some(version) if version.split('+').next() != Some(WANTED) => troubles.push(format!(
                "libtorch: expected version {WANTED}, got {version}; fetch the right one with scripts/libtorch.py and build again"
            )),
            _ => {}
        }
        if self.threads > self.cores {
            troubles.push(format!(
                "libtorch uses {} threads on {} processors; set model.threads or OMP_NUM_THREADS",
                self.threads, self.cores
            ));
        }
        troubles
    }
}

impl fmt::Display for Libtorch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let version = self.version.as_deref().unwrap_or("of unknown version");
        let device = match self.cuda_devices {
            0 => "CPU".to_owned(),
            n => format!("CPU (a CUDA build with {n} devices; driving one frame at a time uses the CPU)"),
        };
        let threads = if self.threads == 1 { "1 thread".into() } else { format!("{} threads", self.threads) };
        write!(f, "{version}, {device}, {threads} on {} processors", self.cores)?;
        self.file.as_ref().map_or(Ok(()), |file| write!(f, "\n            {file}"))
    }
}

/// The libtorch_cpu that the loader has mapped, on Linux.
fn loaded_file() -> Option<String> {
    let maps = fs::read_to_string("/proc/self/maps").ok()?;
    let line = maps.lines().find(|l| l.contains("libtorch_cpu."))?;
    Some(line[line.find('/')?..].to_owned())
}

/// `build-version` of a libtorch folder, or `version.py` of a Python environment's torch.
fn version_beside(file: &Path) -> Option<String> {
    let root = file.parent()?.parent()?;
    if let Ok(version) = fs::read_to_string(root.join("build-version")) {
        return Some(version.trim().to_owned());
    }
    let python = fs::read_to_string(root.join("version.py")).ok()?;
    let line = python.lines().find(|l| l.starts_with("__version__"))?;
    Some(line.split('\'').nth(1)?.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_libtorch_in_use_is_the_one_that_is_wanted() {
        let libtorch = libtorch();
        assert_eq!(libtorch.version.as_deref().and_then(|v| v.split('+').next()), Some(WANTED), "{libtorch}");
        assert!(libtorch.troubles().is_empty(), "{libtorch}");
    }

    #[test]
    fn the_processor_is_told_with_its_kind() {
        let processor = processor();
        assert!(processor.contains(&format!("({}", std::env::consts::ARCH)), "{processor}");
        if cfg!(all(target_arch = "x86_64", target_os = "linux")) {
            assert!(!processor.starts_with("a processor without a name"), "{processor}");
        }
    }

    #[test]
    fn another_version_or_too_many_threads_are_troubles() {
        let odd = Libtorch { version: Some("2.11.0+cpu".into()), file: None, cuda_devices: 0, threads: 8, cores: 2 };
        let troubles = odd.troubles();
        assert!(troubles[0].contains("expected version 2.13.0, got 2.11.0+cpu"), "{troubles:?}");
        assert!(troubles[1].contains("8 threads on 2 processors"), "{troubles:?}");
    }
}
