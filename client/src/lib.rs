//! Skycell client.
