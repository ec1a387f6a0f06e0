//! Float64 twins of the kernels: slow, obvious, the oracle of tests and of the accuracy axis.
