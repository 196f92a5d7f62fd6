//! Skycell server.
