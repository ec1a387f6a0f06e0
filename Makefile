# Two commands do everything on a fresh machine: `make run` and `make test`. The rest are their parts.
.DEFAULT_GOAL := help
.PHONY: help setup run test effects faults soak fuzz check spirv shaders bench bench-quick figures figures-written

# Where rustup puts cargo, for shells that have not read its environment.
export PATH := $(HOME)/.cargo/bin:$(PATH)
# Blocks are solved in parallel by the program itself; a threaded BLAS below would only get in its way.
export OPENBLAS_NUM_THREADS := 1

QIRF := cargo run --release --locked --quiet --
# Where `make run` puts what it makes.
OUT ?= out

help: ## these lines
	@grep -E '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/:[^#]*## /\t/' | expand -t 13

setup: ## install what building and running needs (Debian, Ubuntu); says what it does
	@tools/setup

# MODEL=file: an orbit of that model. Else: this machine's device checked, a synthetic capture made, trained and pruned.
run: setup ## the demo, up to its report; MODEL=file.ply renders an orbit of that model
	@echo "building (the first time takes some minutes)"
	@cargo build --release --locked
ifdef MODEL
	$(QIRF) render "$(MODEL)" --orbit 8 -o "$(OUT)/orbit"
else
	$(QIRF) selftest
	$(QIRF) synth "$(OUT)/demo"
	$(QIRF) run "$(OUT)/demo" -o "$(OUT)/trained" --preset quick
	$(QIRF) render "$(OUT)/trained/model.ply" --orbit 8 -o "$(OUT)/orbit"
	@echo
	@echo "The compressed model lies in $(OUT)/trained, an orbit of it in $(OUT)/orbit."
	@echo "All of it on one page: $(OUT)/trained/report.html"
endif

test: setup ## all tests, on this machine's Vulkan device
	cargo test --locked

faults: ## 10,000 damaged files of every format, in some minutes; kills, full disks and the rest are part of `make test`
	cargo test --locked --test program -- --ignored --exact program::faults::mutations::ten_thousand_mutations --nocapture

soak: ## 20,000 iterations of runs, prunes, resumes and compressions in one process: memory must stay flat
	cargo test --locked --test program -- --ignored --nocapture soak::

effects: ## what each effect is worth on the synthetic scenes made for it: the table of docs/effects.md
	cargo test --locked --test device -- --ignored --nocapture effects::worth::table | grep '^|'

# Needs `cargo install cargo-fuzz`; RUSTC_BOOTSTRAP lets the toolchain at hand take its flags. Readers are safe Rust, so that
# no sanitizer is asked for. Targets: tests/fuzz/targets.
TARGET ?= ply
SECONDS_OF_FUZZ ?= 60
fuzz: ## coverage-guided fuzzing of one reader for a minute; TARGET=name, SECONDS_OF_FUZZ=n
	QIRF_FUZZ_CORPUS="$(CURDIR)/tests/fuzz/corpus" cargo test --locked --test program -- --ignored --exact program::faults::mutations::seeds
	cd tests/fuzz && RUSTC_BOOTSTRAP=1 cargo fuzz run --fuzz-dir . -s none $(TARGET) -- -max_total_time=$(SECONDS_OF_FUZZ) -rss_limit_mb=2048 -timeout=20

check: ## formatting, lints, shaders, documentation
	cargo fmt --check
	rustfmt --check --edition 2024 tools/spirv.rs
	cargo clippy --locked --all-targets -- -D warnings
	@$(MAKE) --no-print-directory shaders
	RUSTDOCFLAGS="-D warnings" cargo doc --locked --no-deps --document-private-items --quiet

# The SPIR-V lies beside its sources, so that building takes no shader compiler.
SPIRV := target/spirv
$(SPIRV): tools/spirv.rs tools/compile.rs
	@mkdir -p $(@D)
	@rustc --edition 2024 -O -A dead_code -o $@ $<

spirv: $(SPIRV) ## compiles every shader into glsl/spirv; needed after an edit, before the commit
	@$(SPIRV)

shaders: $(SPIRV) ## glsl/spirv against its sources, and every shader through glslangValidator and spirv-val
	@$(SPIRV) --check
	@tools/check-shaders

# Groups carry the names of stages; BENCH=culling runs one. Figures and how they were taken: docs/performance.md.
bench: ## benchmarks by stage, on this machine's Vulkan device; BENCH=group for one
	cargo bench --locked --bench engine -- $(BENCH)

bench-quick: ## the same in a few minutes, with wider spread; BENCH=group for one
	QIRF_BENCH_QUICK=1 cargo bench --locked --bench engine -- $(BENCH)

# All is built before anything is measured. What was measured stays in target/figures until the next time.
FIGURES := target/figures
QIRF_BENCH_QUICK ?= 1
figures: ## measures, then writes docs/figures and the tables of docs/performance.md and README.md (ten minutes)
	cargo build --release --locked --bin qirf-vk --example figures
	cargo bench --locked --bench engine --no-run
	rm -rf "$(FIGURES)"
	mkdir -p "$(FIGURES)"
	CRITERION_HOME="$(CURDIR)/$(FIGURES)/criterion" QIRF_BENCH_QUICK="$(QIRF_BENCH_QUICK)" cargo bench --locked --bench engine
	$(QIRF) synth "$(FIGURES)/demo"
	$(QIRF) sweep "$(FIGURES)/demo" -o "$(FIGURES)/sweep"
	@$(MAKE) --no-print-directory figures-written

# The second half alone, from what was measured.
figures-written:
	cargo run --release --locked --quiet --example figures -- "$(FIGURES)/criterion" "$(FIGURES)/sweep/sweep.json" \
		"$$(git describe --always --dirty 2>/dev/null || echo unknown)" "make figures"
