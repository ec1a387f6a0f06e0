//! PSNR, SSIM and LPIPS between a picture and its photo, as the 3DGS papers report them, on the CPU.

mod error;
mod image;
pub mod lpips;
mod scores;
pub mod ssim;

pub use error::Error;
pub use image::{Image, psnr, round_trip_8bit};
pub use lpips::{Kind, Lpips, Range};
pub use scores::{Networks, Scores, evaluate, mean};
pub use ssim::ssim;
