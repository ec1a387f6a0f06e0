//! Tests without a Vulkan device: readers and writers, twins, solvers, statistics.

mod support;

mod host {
    mod architecture;
    mod damage;
    mod depth_maps;
    mod effects;
    mod figures;
    mod formats;
    mod initialise;
    mod learnt_mask;
    mod metrics;
    mod qirf;
    mod reference;
    mod scenes;
    mod synth;
}
