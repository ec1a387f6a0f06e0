//! A viewer for browsers, drawn by this program's own renderer: what is seen is what is measured.
//!
//! One port serves one page, and one WebSocket a client. A client wishes for pictures ([`protocol`]); the newest wish of each
//! waits in the lobby; whoever owns the device takes it from there and draws it ([`Studio`], and [`Live`] for a run). Moving pictures are JPEG and
//! may leave Gaussians out; still pictures are the very PNG files that `qirf-vk render` writes.

pub mod alone;
mod client;
mod easel;
mod guard;
mod http;
mod live;
mod lobby;
pub mod paint;
pub mod protocol;
mod server;
mod studio;
pub mod subject;

pub use live::Live;
pub use lobby::Lobby;
pub use server::{Server, ServerOptions};
pub use studio::Studio;
pub use subject::Subject;
