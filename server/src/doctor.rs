//! `skycell-server doctor`: what renders here, what is missing and how to get it.

use crate::gpu::{AdapterReport, Gpu};

/// How to say it.
#[derive(Clone, Debug, clap::Args)]
pub struct DoctorArguments {
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

/// What helps where no adapter was found.
const ADVICE: &str = "No adapter was found.
  Debian, Ubuntu:  apt-get install libvulkan1 mesa-vulkan-drivers   (a software driver: slow, correct)
  Fedora:          dnf install vulkan-loader mesa-vulkan-drivers
  NVIDIA:          the proprietary driver brings its own Vulkan driver; the loader (libvulkan1) is still needed
  A file named by VK_DRIVER_FILES or VK_ICD_FILENAMES that does not exist hides every driver.";

/// Looks at the adapters and says what is found.
///
/// # Errors
/// When no adapter can render.
pub fn run(arguments: &DoctorArguments) -> anyhow::Result<()> {
    let adapters = futures_util::FutureExt::now_or_never(AdapterReport::all()).unwrap_or_default();
    let chosen = Gpu::open_blocking();
    let chosen_name = chosen.as_ref().ok().map(|gpu| gpu.info.name.clone());
    if arguments.json {
        let report = serde_json::json!({
            "adapters": adapters,
            "chosen": chosen_name,
            "error": chosen.as_ref().err().map(ToString::to_string),
        });
        println!("{report:#}");
    } else if adapters.is_empty() {
        println!("{ADVICE}");
    } else {
        for adapter in &adapters {
            print_adapter(adapter, chosen_name.as_deref() == Some(&adapter.name));
        }
    }
    match chosen {
        Ok(_) => Ok(()),
        Err(error) => Err(error.into()),
    }
}

fn print_adapter(adapter: &AdapterReport, chosen: bool) {
    let mark = if chosen { " (renders)" } else { "" };
    println!("{}{mark}", adapter.name);
    println!("  driver           {}", adapter.driver);
    println!(
        "  interface        {}, {}",
        adapter.backend, adapter.device_type
    );
    let timing = if adapter.timestamps {
        "by the device's timestamps"
    } else {
        "none: GPU times are reported as 0"
    };
    println!("  pass timing      {timing}");
    println!("  cache pages      {}", adapter.texture_layers_max);
    println!(
        "  storage buffers  {} MiB",
        adapter.storage_buffer_max_bytes >> 20
    );
    for missing in &adapter.missing {
        println!("  missing          {missing}");
    }
    if adapter.device_type == "Cpu" {
        println!("  note             a software driver: expect tens of CPU milliseconds a frame");
    }
}
