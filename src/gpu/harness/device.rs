//! Methods of a device for tests.

use super::order::{Derived, Forget, Order};
use super::red_zone::Guards;
use crate::gpu::device::Device;

impl Device {
    /// Names of the buffers, alive or dropped, behind whose end a kernel wrote; always empty unless the device was
    /// opened with [`super::Harness::guarded`]. All submitted work must have been waited for.
    pub fn overrun_buffers(&self) -> Vec<String> {
        self.context().guards.as_ref().map(Guards::overrun).unwrap_or_default()
    }

    /// Sets another order, and the barriers to leave out from here on. Returns the barriers derived since the last
    /// call.
    ///
    /// # Panics
    /// If the device was opened without [`super::Harness::order`].
    pub fn reorder(&self, order: Order, forget: Forget) -> Vec<Derived> {
        self.context().disorder.as_ref().expect("the device was opened with an order").reorder(order, forget)
    }
}
