//! The thread that owns the GPU: takes commands, updates caches, composites frames, reads them
//! back.

pub mod interface;
