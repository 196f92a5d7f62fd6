//! The service edge over real HTTP and real WebSockets, with a stand-in for the renderer.

mod apart;
mod client;
mod conformance;
mod durability;
mod figures;
mod lifecycle;
mod limits;
mod maps;
mod openapi;
mod proxies;
mod revisions;
mod scene;
mod scene_events;
mod sky_time;
mod stand_in;
mod stream;
mod stream_refusals;
mod stream_video;
mod tls;
mod tokens;
mod world;
