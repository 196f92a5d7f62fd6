//! `skycell-server token new`: makes tokens.

use std::io::Write;

use anyhow::Context;
use clap::{Args, Subcommand, ValueEnum};

use crate::access::{Role, Token, TokenDigest, TokenEntry, is_name};

/// Arguments of `skycell-server token`.
#[derive(Debug, Args)]
pub struct TokenArguments {
    #[command(subcommand)]
    command: TokenCommand,
}

#[derive(Debug, Subcommand)]
enum TokenCommand {
    /// Make a token. It is printed once; the server keeps only its hash.
    ///
    /// The token goes to stdout, and the line for the server's tokens_file to stderr.
    #[command(
        after_help = "Examples:\n  skycell-server token new --role view --name guests\n  \
                      skycell-server token new --role admin --name ops 2>> /etc/skycell/tokens > ops.token"
    )]
    New {
        /// What its holder may do: view watches, steer changes the sky, admin does everything.
        #[arg(long)]
        role: RoleArgument,
        /// Who holds it: 1 to 64 letters, digits, - . or _. Without it a random one.
        #[arg(long, value_parser = name)]
        name: Option<String>,
    },
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum RoleArgument {
    View,
    Steer,
    Admin,
}

impl From<RoleArgument> for Role {
    fn from(role: RoleArgument) -> Self {
        match role {
            RoleArgument::View => Self::View,
            RoleArgument::Steer => Self::Steer,
            RoleArgument::Admin => Self::Admin,
        }
    }
}

fn name(text: &str) -> Result<String, String> {
    if is_name(text) {
        Ok(text.to_owned())
    } else {
        Err("1 to 64 letters, digits, - . or _".to_owned())
    }
}

/// Runs the command.
///
/// # Errors
/// If the system gives no random numbers, or nobody takes what is printed.
pub fn run(arguments: &TokenArguments) -> anyhow::Result<()> {
    let TokenCommand::New { role, name } = &arguments.command;
    let token = Token::new_random().context("the system gives no random numbers")?;
    let digest = TokenDigest::of(token.text());
    let entry = TokenEntry {
        role: (*role).into(),
        name: name
            .clone()
            .unwrap_or_else(|| format!("token-{}", &digest.to_hex()[..8])),
        digest,
    };
    // Apart, so that each can be sent into a file of its own.
    writeln!(std::io::stdout(), "{}", token.text())?;
    writeln!(std::io::stderr(), "{entry}")?;
    Ok(())
}
