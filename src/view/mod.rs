//! A viewer for browsers, drawn by this program's own renderer: what is seen is what is measured.
//!
//! One port serves one page, and one WebSocket a client. A client requests pictures ([`protocol`]); the newest request of each
//! waits in the requests; whoever owns the device takes it from there and draws it ([`StaticView`], and [`Live`] for a run). Moving pictures are JPEG and
//! may leave Gaussians out; still pictures are the very PNG files that `qirf-vk render` writes.

pub mod alone;
mod client;
mod guard;
mod http;
mod live;
pub mod paint;
mod painter;
pub mod protocol;
mod requests;
mod server;
mod static_view;
pub mod subject;

pub use live::Live;
pub use requests::Requests;
pub use server::{Server, ServerOptions};
pub use static_view::StaticView;
pub use subject::Subject;
