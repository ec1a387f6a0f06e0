//! Tests of the program as a user runs it: its commands, its files, and its behaviour when things go wrong.

mod support;

mod program {
    mod attrition;
    mod benchmark;
    #[cfg(unix)] // as `shard`
    mod blocks;
    mod cli;
    mod compare;
    mod compress;
    mod devices;
    mod dispatched;
    mod edit;
    mod effects;
    mod ended;
    #[cfg(unix)] // limits and signals are the system's
    mod faults;
    #[cfg(unix)] // with shell scripts in place of programs
    mod gpu_report;
    mod html;
    mod larger;
    mod planted;
    #[cfg(unix)] // with a shell script in COLMAP's place
    mod pose;
    mod report;
    mod resume;
    mod run;
    #[cfg(unix)] // with signals
    mod shard;
    mod sizes;
    mod soak;
    mod sweep;
    #[cfg(unix)] // signals are the system's
    mod view;
    mod walks;
}
