//! The render service's binary.

use clap::Parser;

#[derive(Parser)]
enum Command {
    /// One picture without a server.
    Render(skycell_server::render_command::RenderArguments),
}

fn main() -> anyhow::Result<()> {
    match Command::parse() {
        Command::Render(arguments) => skycell_server::render_command::run(&arguments),
    }
}
