//! A viewer for browsers, drawn by this program's own renderer: it shows the pictures that are measured.
//!
//! One port serves one page, and one WebSocket per client. A client requests pictures ([`protocol`]); the queue keeps
//! the newest request of each; the owner of the device takes requests from the queue and draws them ([`StaticView`],
//! and [`Live`] for a run). Moving pictures are JPEG and may leave Gaussians out; still pictures are exactly the PNG
//! files that `qirf-vk render` writes.

pub mod alone;
pub mod capture;
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
