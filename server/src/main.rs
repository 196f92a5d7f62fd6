//! `skycell-server`: the command line of the service.

mod serve;

use std::io::Write;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, Parser, Subcommand};
use skycell_server::config::{Config, Flags, LogFormat};
use skycell_server::doctor::{self, DoctorArguments};
use skycell_server::measure::{self, MeasureArguments};
use skycell_server::probe::{self, command::ProbeArguments};
use skycell_server::render_command::{self, RenderArguments};
use skycell_server::token_command::{self, TokenArguments};

/// Renders a shared sky and streams it to its viewers.
#[derive(Parser)]
#[command(name = "skycell-server", version, about)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Serve the sky to viewers.
    #[command(
        after_help = "Example: skycell-server serve --listen 127.0.0.1:8080 --state ~/.local/state/skycell"
    )]
    Serve(ServeArgs),
    /// Print the resolved configuration, each value with where it comes from.
    #[command(after_help = "Example: skycell-server config --config skycell.toml")]
    Config(ServeArgs),
    /// Render one picture from a scene file and a camera, without a server.
    #[command(
        after_help = "Example: skycell-server render --scene sunset.json --yaw-deg 250 --pitch-deg 10 --out sunset.png"
    )]
    Render(Box<RenderArguments>),
    /// Evaluate phase, shell intersection or density at given points, in f64 and on the device, as JSON.
    #[command(after_help = "Example: skycell-server probe phase --angles-deg 0,1,10,90")]
    Probe(ProbeArguments),
    /// Measure what each setting costs in time and in error.
    Measure(MeasureArguments),
    /// Say which adapters there are, whether they can render, and how to get what is missing.
    #[command(after_help = "Example: skycell-server doctor --json")]
    Doctor(DoctorArguments),
    /// Make the tokens that a server demands.
    Token(TokenArguments),
}

#[derive(Args)]
struct ServeArgs {
    /// Listen here instead of on 127.0.0.1:8080.
    #[arg(long, value_name = "ADDR:PORT")]
    listen: Option<SocketAddr>,
    /// Keep the scene and the noise cache in this folder.
    #[arg(long, value_name = "DIR")]
    state: Option<PathBuf>,
    /// Read settings from this TOML file. SKYCELL_... variables and flags override it.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Write the log like this: a line for people, or a JSON object a line.
    #[arg(long, value_name = "FORMAT")]
    log_format: Option<LogFormat>,
}

impl ServeArgs {
    fn flags(self) -> Flags {
        Flags {
            listen: self.listen,
            state_dir: self.state,
            log_format: self.log_format,
            file: self.config,
        }
    }
}

fn main() -> ExitCode {
    let result = match Cli::parse().command {
        Command::Serve(args) => serve(args),
        Command::Config(args) => print_config(args),
        Command::Render(arguments) => render_command::run(&arguments),
        Command::Probe(arguments) => probe::command::run(&arguments),
        Command::Measure(arguments) => measure::run(&arguments),
        Command::Doctor(arguments) => doctor::run(&arguments),
        Command::Token(arguments) => token_command::run(&arguments),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("skycell-server: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn serve(args: ServeArgs) -> anyhow::Result<()> {
    serve::run(Config::load(&args.flags())?)
}

fn print_config(args: ServeArgs) -> anyhow::Result<()> {
    let mut out = std::io::stdout().lock();
    for origin in Config::explain(&args.flags())? {
        let value = origin.value.to_string();
        writeln!(out, "{:<28} {value:<40} {}", origin.key, origin.from)?;
    }
    Ok(())
}
