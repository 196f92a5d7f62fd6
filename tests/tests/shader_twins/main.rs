//! The physical functions of the WGSL, run on the real device, against twins in f64 that are written from the equations.
//! Every bound is an error budget of f32 arithmetic, and each test shows that a planted defect breaks it. Each function
//! prints a row: points, worst of its bound, the defect (`-- --nocapture`).

mod above;
mod density;
mod geometry;
mod maps;
mod march;
mod phase;
mod sheet;
mod sky;
mod sun_volume;
mod support;
mod temporal;
mod tone;
mod transport;
