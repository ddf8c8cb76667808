//! Photographs, masks and depth maps: decoded, undistorted, made smaller, kept in memory or read again.

mod alpha;
pub(super) mod cache;
pub(super) mod codec;
pub(super) mod decoder;
pub(super) mod depth;
mod jpeg;
pub(super) mod masks;
pub(super) mod panorama;
pub(super) mod photograph;
pub(super) mod picture;
pub(super) mod reading;
mod resize;
pub(super) mod undistort;
