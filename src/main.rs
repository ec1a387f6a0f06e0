//! The `qirf-vk` program.

fn main() -> std::process::ExitCode {
    qirf_vk::cli::main()
}
