//! The sky read from tables on the device against the integration of the same air in f64.

mod bands;
mod sky;
