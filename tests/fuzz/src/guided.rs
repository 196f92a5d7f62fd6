//! The targets for a coverage-guided fuzzer, libFuzzer; `deploy/fuzz` builds and runs this.
//!
//! `SKYCELL_FUZZ_TARGET` names the target; without it the names are listed. `SKYCELL_FUZZ_SEEDS`, if set, is a folder into
//! which its seeds are written. Every other mutation is one that the target's kind of input survives (JSON stays JSON, a
//! PNG's checksums stay right), the rest are libFuzzer's own.

#![no_main]
// libFuzzer looks for functions by name.
#![allow(unsafe_code)]

use libfuzzer_sys::{Corpus, fuzz_mutator, fuzz_target};
use skycell_fuzz::mutate::{Input, mutated_input};
use skycell_fuzz::{TARGETS, Target, target};
use std::cell::RefCell;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::OnceLock;

/// The target and its seeds.
static CHOSEN: OnceLock<(&Target, Vec<Input>)> = OnceLock::new();

thread_local! {
    static LAST_PANIC: RefCell<String> = RefCell::default();
}

fn stop(why: &str) -> ! {
    eprintln!("{why}");
    std::process::exit(2)
}

fn chosen() -> &'static (&'static Target, Vec<Input>) {
    CHOSEN.get_or_init(|| {
        let Ok(name) = std::env::var("SKYCELL_FUZZ_TARGET") else {
            for target in TARGETS {
                println!("{}", target.name);
            }
            std::process::exit(0)
        };
        match target(&name) {
            Some(target) => (target, (target.seeds)()),
            None => stop(&format!("there is no target {name}")),
        }
    })
}

fn begin() {
    let (_, seeds) = chosen();
    if let Some(folder) = std::env::var_os("SKYCELL_FUZZ_SEEDS") {
        for (index, seed) in seeds.iter().enumerate() {
            let file = Path::new(&folder).join(format!("seed-{index}"));
            if let Err(error) = std::fs::write(&file, seed.bytes()) {
                stop(&format!("{}: {error}", file.display()));
            }
        }
    }
    // In place of libfuzzer-sys's hook, which aborts: the decoder of EXR files has panics of its own, and the map's reader
    // turns them into an error.
    std::panic::set_hook(Box::new(|panic| {
        LAST_PANIC.with_borrow_mut(|last| *last = panic.to_string());
    }));
}

fuzz_target!(init: begin(), |input: &[u8]| -> Corpus {
    let (target, _) = chosen();
    if catch_unwind(AssertUnwindSafe(|| (target.run)(input))).is_err() {
        eprintln!("{}: {}", target.name, LAST_PANIC.with_borrow(String::clone));
        std::process::abort();
    }
    Corpus::Keep
});

fuzz_mutator!(|data: &mut [u8], size: usize, max_size: usize, seed: u32| {
    let mut rng = fastrand::Rng::with_seed(seed.into());
    let (_, seeds) = chosen();
    if rng.bool()
        && let Some(input) = seeds[0].of_same_kind(&data[..size])
    {
        let bytes = mutated_input(&input, seeds, &mut rng);
        if bytes.len() <= max_size {
            data[..bytes.len()].copy_from_slice(&bytes);
            return bytes.len();
        }
    }
    libfuzzer_sys::fuzzer_mutate(data, size, max_size)
});
