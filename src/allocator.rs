//! Takes Rust's own large blocks of memory directly from the system, and returns them directly.
//!
//! libtorch's tensors and everything else share glibc's allocator, and libtorch needs it to keep its memory
//! ([`keep_tensor_memory`](lapwing_learn::nn::runtime::keep_tensor_memory)): the memory of a large message would stay
//! forever, once for each thread that ever had one. Rust's blocks of 1 MiB or more are messages, pictures and files,
//! which come and go; mapped one by one they are released with their owner, and growing one copies nothing. libtorch
//! does not allocate through Rust and is not affected.

use std::alloc::{GlobalAlloc, System};

#[cfg(target_os = "linux")]
use std::{alloc::Layout, ptr};

/// Blocks of at least this many bytes are mapped. A telemetry has 21 KB, a frame 154 KB.
#[cfg(target_os = "linux")]
const LARGE: usize = 1 << 20;

/// The allocator of a program: the system's, except for large blocks.
#[derive(Debug)]
pub struct Allocator;

#[cfg(target_os = "linux")]
fn is_mapped(layout: Layout) -> bool {
    // A mapping begins on a page; nothing here needs a larger alignment.
    layout.size() >= LARGE && layout.align() <= 4096
}

#[cfg(target_os = "linux")]
fn map(size: usize) -> *mut u8 {
    let (access, kind) = (libc::PROT_READ | libc::PROT_WRITE, libc::MAP_PRIVATE | libc::MAP_ANONYMOUS);
    // SAFETY: a new mapping that does not overlay another.
    let at = unsafe { libc::mmap(ptr::null_mut(), size, access, kind, -1, 0) };
    if at == libc::MAP_FAILED { ptr::null_mut() } else { at.cast() }
}

// SAFETY: a block's layout decides where it comes from and goes to, and is the same at both ends; mappings are as
// large as asked for and aligned to pages.
#[cfg(target_os = "linux")]
unsafe impl GlobalAlloc for Allocator {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // SAFETY: the caller upholds the contract.
        if is_mapped(layout) { map(layout.size()) } else { unsafe { System.alloc(layout) } }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        // SAFETY: the caller upholds the contract; a new mapping is all zeros.
        if is_mapped(layout) { map(layout.size()) } else { unsafe { System.alloc_zeroed(layout) } }
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        if is_mapped(layout) {
            // SAFETY: it was mapped with this size. It fails only if the system is out of mappings; the block then
            // leaks.
            unsafe { libc::munmap(block.cast(), layout.size()) };
        } else {
            // SAFETY: the caller upholds the contract.
            unsafe { System.dealloc(block, layout) }
        }
    }

    unsafe fn realloc(&self, block: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        // SAFETY: the caller ensures that the size does not overflow when rounded up to the alignment.
        let new = unsafe { Layout::from_size_align_unchecked(size, layout.align()) };
        match (is_mapped(layout), is_mapped(new)) {
            // SAFETY: the caller upholds the contract.
            (false, false) => unsafe { System.realloc(block, layout, size) },
            (true, true) => {
                // SAFETY: it was mapped with this size.
                let at = unsafe { libc::mremap(block.cast(), layout.size(), size, libc::MREMAP_MAYMOVE) };
                if at == libc::MAP_FAILED { ptr::null_mut() } else { at.cast() }
            }
            _ => {
                // SAFETY: two blocks of at least the smaller size, and the old one is freed only after it is copied.
                unsafe {
                    let at = self.alloc(new);
                    if !at.is_null() {
                        ptr::copy_nonoverlapping(block, at, layout.size().min(size));
                        self.dealloc(block, layout);
                    }
                    at
                }
            }
        }
    }
}

// SAFETY: the system's allocator, unchanged.
#[cfg(not(target_os = "linux"))]
unsafe impl GlobalAlloc for Allocator {
    unsafe fn alloc(&self, layout: std::alloc::Layout) -> *mut u8 {
        // SAFETY: the caller upholds the contract.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: std::alloc::Layout) {
        // SAFETY: the caller upholds the contract.
        unsafe { System.dealloc(block, layout) }
    }
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    fn layout(size: usize) -> Layout {
        Layout::from_size_align(size, 8).expect("eight is a power of two")
    }

    #[test]
    fn a_block_keeps_its_bytes_as_it_grows_and_shrinks_across_the_limit() {
        let sizes = [100, LARGE - 1, LARGE, 5 * LARGE + 3, 64 * LARGE, LARGE, LARGE - 1, 10];
        // SAFETY: each layout is the one that the block was made with.
        unsafe {
            let mut block = Allocator.alloc(layout(sizes[0]));
            for i in 0..10 {
                *block.add(i) = i as u8;
            }
            for pair in sizes.windows(2) {
                block = Allocator.realloc(block, layout(pair[0]), pair[1]);
                assert!(!block.is_null());
                assert!((0..10).all(|i| *block.add(i) == i as u8), "{pair:?}");
                *block.add(pair[1] - 1) = 9; // the last byte is there, and 9 is the tenth's
            }
            Allocator.dealloc(block, layout(10));
        }
    }

    #[test]
    fn a_large_block_is_zeroed_where_that_is_asked_for_and_gone_once_it_is_given_back() {
        let resident = || {
            let text = std::fs::read_to_string("/proc/self/statm").unwrap();
            text.split_whitespace().nth(1).unwrap().parse::<usize>().unwrap() * 4096
        };
        let size = 256 * LARGE;
        // SAFETY: the same layout at both ends.
        unsafe {
            let block = Allocator.alloc_zeroed(layout(size));
            assert!((0..size).step_by(4096).all(|i| *block.add(i) == 0));
            (0..size).step_by(4096).for_each(|i| *block.add(i) = 1);
            let held = resident();
            Allocator.dealloc(block, layout(size));
            assert!(resident() + size / 2 < held, "{} of {held} left", resident());
        }
    }

    #[test]
    fn a_block_that_nobody_can_have_is_refused_in_peace() {
        // SAFETY: null is not used.
        assert!(unsafe { Allocator.alloc(layout(isize::MAX as usize - 4096)) }.is_null());
    }
}
