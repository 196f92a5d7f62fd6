//! Every parser of what strangers send, what holds for what it takes, and inputs that it takes.
//!
//! One list serves two: the test `fuzz` gives each parser a number of mutations of its inputs; `deploy/fuzz` (the program
//! `guided`, behind the feature of that name) hands the same parsers to libFuzzer, which goes on from inputs that reached
//! code that none before had.

// Claims about what is taken fail by panics.
#![allow(clippy::expect_used)]

pub mod mutate;
mod seeds;
mod targets;

use mutate::Input;
use std::io;
use std::path::{Path, PathBuf};

/// A parser and what it is fed with.
#[derive(Clone, Copy, Debug)]
pub struct Target {
    /// In figures, names of files and on the command line.
    pub name: &'static str,
    /// Inputs that are taken.
    pub seeds: fn() -> Vec<Input>,
    /// Gives the parser an input and says whether it was taken. Panics where the parser does, or where what was taken does
    /// not hold what its type promises.
    pub run: fn(&[u8]) -> bool,
}

impl Target {
    /// Inputs that once made the parser panic: files in `regressions/NAME`, by name.
    ///
    /// # Errors
    /// When a file cannot be read.
    pub fn regressions(&self) -> io::Result<Vec<(PathBuf, Vec<u8>)>> {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("regressions")
            .join(self.name);
        if !folder.is_dir() {
            return Ok(Vec::new());
        }
        let mut files = std::fs::read_dir(folder)?
            .map(|entry| Ok(entry?.path()))
            .collect::<io::Result<Vec<_>>>()?;
        files.sort();
        files
            .into_iter()
            .map(|path| Ok((path.clone(), std::fs::read(path)?)))
            .collect()
    }
}

/// The list, for the constant and for tests that are named by what they claim.
macro_rules! targets {
    ($($claim:ident: $name:literal, $seeds:path, $run:path;)*) => {
        /// Every target.
        pub const TARGETS: &[Target] = &[$(Target { name: $name, seeds: $seeds, run: $run }),*];

        /// Makes a test of each target that calls `$test` with the target.
        #[macro_export]
        macro_rules! tests_of_targets {
            ($test:path) => {
                $(#[test] fn $claim() { $test($crate::target($name).expect("in the list")); })*
            };
        }
    };
}

/// The target of a name.
pub fn target(name: &str) -> Option<&'static Target> {
    TARGETS.iter().find(|target| target.name == name)
}

targets! {
    no_message_of_a_client_panics: "client-messages", seeds::client_messages, targets::client_message;
    no_hello_panics: "hello", seeds::hellos, targets::client_message;
    no_message_of_a_server_panics: "server-messages", seeds::server_messages, targets::server_message;
    no_scene_document_panics: "scenes", seeds::scenes, targets::scene;
    no_merge_patch_panics: "merge-patches", seeds::merge_patches, targets::merge_patch;
    no_json_patch_panics: "json-patches", seeds::json_patches, targets::json_patch;
    no_map_of_a_png_panics: "maps-png", seeds::pngs, targets::map;
    no_map_of_an_exr_panics: "maps-exr", seeds::exrs, targets::map;
    no_frame_panics: "frames", seeds::frames, targets::frame;
    no_picture_of_clouds_panics: "clouds", seeds::clouds, targets::clouds;
    no_line_of_a_token_panics: "tokens", seeds::token_lines, targets::token_line;
    no_camera_path_panics: "camera-paths", seeds::camera_paths, targets::camera_path;
    no_configuration_panics: "configurations", seeds::configurations, targets::configuration;
}
