//! Every parser of what strangers send, with inputs that were valid once: none may panic, and what is taken has to hold
//! what its type promises.
//!
//! Each target gets 20 000 inputs (`SKYCELL_FUZZ_INPUTS` sets another number, `SKYCELL_FUZZ_SEED` another beginning). An input
//! that fails is printed and kept in `target/fuzz`. Inputs in `tests/fuzz/regressions/TARGET` failed once: each is given first.
//!
//! ```text
//! SKYCELL_FUZZ_INPUTS=1000000 cargo test --release -p skycell-fuzz --test fuzz -- --nocapture
//! ```

use std::cell::RefCell;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::sync::Once;
use std::time::Instant;

use fastrand::Rng;
use skycell_fuzz::{Target, mutate, tests_of_targets};

/// Inputs of a target where nobody says.
const INPUTS: u64 = 20_000;

thread_local! {
    /// What has panicked in this thread: how often, and what the last panic said.
    static PANICS: RefCell<(u64, String)> = RefCell::default();
}

/// Counts panics in silence: the decoder of EXR files has some of its own, which the map's reader turns into an error.
fn count_panics() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        std::panic::set_hook(Box::new(|panic| {
            PANICS.with_borrow_mut(|(count, last)| {
                *count += 1;
                *last = panic.to_string();
            });
        }));
    });
}

/// Runs a target with what failed once and with mutations of its seeds; says how many inputs it took.
fn fuzz(target: &Target) {
    let Target { name, seeds, run } = *target;
    let seeds = seeds();
    for (file, bytes) in target.regressions().expect("files") {
        println!("{name}: {}", file.display());
        run(&bytes);
    }
    let number = |variable: &str| {
        std::env::var(variable)
            .ok()
            .and_then(|text| text.parse::<u64>().ok())
    };
    let inputs = number("SKYCELL_FUZZ_INPUTS").unwrap_or(INPUTS);
    let mut rng = Rng::with_seed(number("SKYCELL_FUZZ_SEED").unwrap_or(1));
    for (index, seed) in seeds.iter().enumerate() {
        if !run(&seed.bytes()) {
            fail(&format!("{name}: seed {index} is refused"));
        }
    }
    let started = Instant::now();
    count_panics();
    let mut taken = 0;
    for count in 0..inputs {
        let bytes = mutate::mutated(&seeds, &mut rng);
        match catch_unwind(AssertUnwindSafe(|| run(&bytes))) {
            Ok(is_taken) => taken += u64::from(is_taken),
            Err(panic) => {
                let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("../fuzz");
                let file = folder.join(format!("{name}-{count}"));
                let kept =
                    std::fs::create_dir_all(&folder).and_then(|()| std::fs::write(&file, &bytes));
                eprintln!(
                    "{name}: {}\ninput {count} ({}; {}): {}",
                    PANICS.with_borrow(|(_, last)| last.clone()),
                    file.display(),
                    if kept.is_ok() { "kept" } else { "not kept" },
                    String::from_utf8_lossy(&bytes)
                );
                let _ = std::panic::take_hook();
                std::panic::resume_unwind(panic);
            }
        }
    }
    println!(
        "{name}: {inputs} inputs, {taken} taken, {} refused, 0 panics ({} in a decoder, caught), {:.1} s",
        inputs - taken,
        PANICS.with_borrow(|(count, _)| *count),
        started.elapsed().as_secs_f64()
    );
    // Mutations that are all refused at the door would test the door alone.
    if taken == 0 || taken == inputs {
        fail(&format!("{name}: {taken} of {inputs} taken"));
    }
}

/// The panic's own message would not be heard.
fn fail(why: &str) -> ! {
    eprintln!("{why}");
    panic!("{why}");
}

tests_of_targets!(fuzz);
