//! Tests on a Vulkan device, stage by stage, under validation layers, with poisoned buffers that end in red zones.

mod support;

mod device {
    mod batches;
    mod bin;
    mod camera_errors;
    mod depth;
    mod effects;
    mod examples;
    mod guards;
    mod no_nan;
    mod opening;
    mod order;
    mod overlap;
    mod participation;
    mod parts;
    mod primitives;
    mod project;
    mod random;
    mod rasterise;
    mod rasterise_backward;
    mod rates;
    mod respond;
    mod rrdm;
    mod selftest;
    mod train;
    mod trial;
    mod watch;
    mod work;
}
