//! Skycell protocol.
