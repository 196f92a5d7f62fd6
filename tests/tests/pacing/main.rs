//! When frames are sent, and how old they are: slow links, crowds that come at once, and where the time goes.

mod crowds;
mod links;
mod rest;
mod stages;
mod turning;

type Outcome = anyhow::Result<()>;
