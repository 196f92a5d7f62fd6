//! `skycell`: record, load-test and edit a shared sky from the command line.

mod commands;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// Thin clients of a Skycell server.
#[derive(Debug, Parser)]
#[command(name = "skycell", version, arg_required_else_help = true)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Record(commands::record::Arguments),
    Load(commands::load::Arguments),
    Scene(commands::scene::Arguments),
}

#[tokio::main]
async fn main() -> ExitCode {
    let result = match Arguments::parse().command {
        Command::Record(arguments) => commands::record::run(arguments).await,
        Command::Load(arguments) => commands::load::run(arguments).await,
        Command::Scene(arguments) => commands::scene::run(arguments).await,
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}
