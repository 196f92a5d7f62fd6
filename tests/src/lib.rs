//! Skycell tests.
