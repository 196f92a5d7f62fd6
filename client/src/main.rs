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
            eprintln!("error: {}", explained(&error));
            ExitCode::FAILURE
        }
    }
}

/// The error and its causes, without those that the text above them already tells.
fn explained(error: &anyhow::Error) -> String {
    let mut text = error.to_string();
    for cause in error.chain().skip(1).map(ToString::to_string) {
        if !text.contains(&cause) {
            text.push_str(": ");
            text.push_str(&cause);
        }
    }
    text
}
