# On a fresh machine two commands do everything: `make run` and `make test`. The other targets are parts of them.
.DEFAULT_GOAL := help
.PHONY: help setup run viewer-picture viewer-speed page-of-a-million test test-quick effects faults floaters soak fuzz check spirv shaders bench bench-quick figures figures-written renders results results-written mutants \
	gpu-kit gpu-kit-folder gpu-report devices msl python-test cluster-test slurm-test

# rustup's folder of cargo, for shells that have not loaded its environment.
export PATH := $(HOME)/.cargo/bin:$(PATH)
# The program solves blocks in parallel itself; a threaded BLAS would only compete with it.
export OPENBLAS_NUM_THREADS := 1

QIRF := cargo run --release --locked --quiet --
# Output folder of `make run`.
OUT ?= out

help: ## list the targets
	@grep -E '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/:[^#]*## /\t/' | expand -t 13

setup: ## install the system packages that building and running need (Debian, Ubuntu)
	@tools/setup

# With MODEL=file, render an orbit of that model. Otherwise check the device, then make, train and prune a synthetic scene.
run: setup ## run the demo up to its report, or render an orbit of MODEL=file.ply
	@echo "Building; the first time takes some minutes."
	@cargo build --release --locked
ifdef MODEL
	$(QIRF) render "$(MODEL)" --orbit 8 -o "$(OUT)/orbit"
else
	$(QIRF) selftest
	$(QIRF) synth "$(OUT)/demo"
	$(QIRF) run "$(OUT)/demo" -o "$(OUT)/trained" --preset quick
	$(QIRF) render "$(OUT)/trained/model.ply" --orbit 8 -o "$(OUT)/orbit"
	@echo
	@echo "Pruned model: $(OUT)/trained/model.ply. An orbit of it: $(OUT)/orbit."
	@echo "Report: $(OUT)/trained/report.html"
endif

test: setup ## run all tests on this machine's Vulkan device
	@tools/test

test-quick: setup ## run the tests that say within minutes whether a change is sane
	@tools/test --quick

devices: setup ## run the device tests and selftest on every software device, tuning and width; one table (an hour)
	@tools/devices

cluster-test: ## compress in tasks under Snakemake, with processes killed on the way; the bytes must be the same (minutes)
	@tools/cluster-test

slurm-test: ## the same through a Slurm of one node, which is started and stopped; needs root, slurm-wlm and munge (minutes)
	@tools/slurm-test

python-test: ## build the Python package and test it in an environment of its own (minutes; needs Python 3.9 with venv)
	@tools/python-test

msl: ## translate every shader into Metal's language; needs spirv-cross (tools/setup --all)
	@tools/check-msl

faults: ## read 10,000 damaged files of every format (minutes); kills and full disks are part of `make test`
	cargo test --locked --test program -- --ignored --exact program::faults::mutations::ten_thousand_mutations --nocapture

floaters: ## plant floaters in the shared models and remove them: the table of docs/edit.md (minutes)
	cargo test --locked --test program -- --ignored --nocapture planted:: | grep '^|'

soak: ## train, prune, resume and compress for 20,000 iterations in one process; memory must stay flat
	cargo test --locked --test program -- --ignored --nocapture soak::

effects: ## measure what each effect is worth: the table of docs/effects.md (half an hour)
	cargo test --locked --test program -- --ignored --nocapture effects::table | grep '^|'

# Needs `cargo install cargo-fuzz`; RUSTC_BOOTSTRAP lets a stable toolchain accept its flags. Readers are safe Rust, so no
# sanitizer is needed. TARGET is the name of an input in tests/support/files/corpus.rs (an unknown one lists them all), or
# `sizes`: what the device is asked for.
TARGET ?= little.ply
SECONDS_OF_FUZZ ?= 60
fuzz: ## fuzz the reader of one input for a minute; TARGET=name, SECONDS_OF_FUZZ=n
	QIRF_FUZZ_CORPUS="$(CURDIR)/tests/fuzz/corpus" cargo test --locked --test program -- --ignored --exact program::faults::mutations::seeds
	cd tests/fuzz && QIRF_FUZZ_INPUT="$(TARGET)" RUSTC_BOOTSTRAP=1 cargo fuzz run --fuzz-dir . -s none \
		$(if $(filter sizes,$(TARGET)),sizes,reader "corpus/$(TARGET)") -- -max_total_time=$(SECONDS_OF_FUZZ) -rss_limit_mb=2048 -timeout=20

# Tables of docs/numerics.md. ONLY=primitives/sort runs the mutants of that shader.
ONLY ?=
mutants: ## remove each barrier and bounds check in turn, and see whether a test notices (half an hour)
	@mkdir -p target
	@rustc --edition 2024 -O -A dead_code -o target/mutants-of-shaders tools/mutants.rs
	@target/mutants-of-shaders $(ONLY)
	cargo test --locked --test device -- --ignored --exact device::order::barriers::each_derived_barrier --nocapture 2>/dev/null

check: ## verify formatting, lints, shaders and documentation
	cargo fmt --check
	rustfmt --check --edition 2024 tools/spirv.rs tools/mutants.rs
	cargo clippy --locked --all-targets --all-features -- -D warnings
	cargo clippy --locked --lib --no-default-features -- -D warnings
	cargo clippy --locked --lib --no-default-features --features pipeline -- -D warnings
	cargo clippy --locked --no-default-features --features cli,faer -- -D warnings
	@$(MAKE) --no-print-directory shaders
	RUSTDOCFLAGS="-D warnings" cargo doc --locked --no-deps --document-private-items --quiet
	for crate in python tests/fuzz; do cargo metadata --locked --format-version 1 --manifest-path $$crate/Cargo.toml >/dev/null || exit 1; done

# The SPIR-V is in the repository beside its sources, so a build needs no shader compiler.
SPIRV := target/spirv
$(SPIRV): tools/spirv.rs tools/compile.rs
	@mkdir -p $(@D)
	@rustc --edition 2024 -O -A dead_code -o $@ $<

spirv: $(SPIRV) ## compile every shader into glsl/spirv; needed after editing one, before the commit
	@$(SPIRV)

shaders: $(SPIRV) ## compare glsl/spirv with its sources; check every shader with glslangValidator and spirv-val
	@$(SPIRV) --check
	@tools/check-shaders

# Programs and data to measure a device with, and to measure it elsewhere: tools/gpu-report. COMPARE: an earlier report's folder, whose times of
# training stand beside the new ones. SCENES: captures that are trained besides. MODULES: folders of modules (QIRF_SHADERS) that are measured
# beside the program's own. Libraries in fallback and layers are for machines without them.
KIT := target/gpu-kit
KIT_MIB := 60
MINUTES ?= 8
SCENES ?=
MODULES ?=
KIT_PROGRAMS := cargo bench --locked --bench engine --bench training --no-run
KIT_TESTS := cargo test --release --locked --test device --no-run
LOADER := libvulkan.so.1
# What NVIDIA's driver loads.
LOADED := libGLdispatch.so.0 libX11.so.6 libXext.so.6 libxcb.so.1 libXau.so.6 libXdmcp.so.6 libbsd.so.0 libmd.so.0
LAYER := VkLayer_khronos_validation
LIBRARIES_HERE := PATH="$$PATH:/usr/sbin:/sbin" ldconfig -p

gpu-kit-folder: setup
	cargo build --release --locked
	$(KIT_PROGRAMS)
	$(KIT_TESTS)
	rm -rf "$(KIT)" "$(KIT).tar.xz"
	for part in lib fallback layers modules scenes source/tests source/glsl source/tools; do mkdir -p "$(KIT)/$$part"; done
	cp tools/gpu-report "$(KIT)"
	@# engine, training and device, without the hashes of their names
	for make in "$(KIT_PROGRAMS)" "$(KIT_TESTS)"; do $$make --message-format json 2>/dev/null; done | \
	  sed -n 's/.*"executable":"\([^"]*\)".*/\1/p' | while read -r program; do \
	    name=$$(basename "$$program"); strip -o "$(KIT)/$${name%-????????????????}" "$$program" || exit 1; done
	strip -o "$(KIT)/qirf-vk" target/release/qirf-vk
	@for program in qirf-vk engine training device; do [ -x "$(KIT)/$$program" ] || { echo "gpu-kit: $$program was not built" >&2; exit 1; }; done
	cp -r tests/golden "$(KIT)/source/tests"
	cp -r glsl/spirv "$(KIT)/source/glsl"
	cp -r tools/examples "$(KIT)/source/tools"
	ldd target/release/qirf-vk | awk '/openblas|gfortran|quadmath/ {print $$3}' | xargs -r cp -L -t "$(KIT)/lib"
	for name in $(LOADER) $(LOADED); do \
	  $(LIBRARIES_HERE) | awk -v name=$$name '$$1 == name {print $$NF; exit}' | xargs -r cp -L -t "$(KIT)/fallback"; done
	$(LIBRARIES_HERE) | awk '$$1 == "lib$(LAYER).so" {print $$NF; exit}' | xargs -r cp -L -t "$(KIT)/layers"
	@for part in fallback/$(LOADER) layers/lib$(LAYER).so; do [ -f "$(KIT)/$$part" ] || { echo "gpu-kit: no $$part here: run tools/setup" >&2; exit 1; }; done
	manifest=$$(find /usr/share/vulkan /etc/vulkan -name $(LAYER).json 2>/dev/null | head -n 1); \
	  [ -n "$$manifest" ] || { echo "gpu-kit: no $(LAYER).json here: run tools/setup" >&2; exit 1; }; \
	  sed 's|\("library_path": *\)"[^"]*"|\1"./lib$(LAYER).so"|' "$$manifest" >"$(KIT)/layers/$(LAYER).json"
	for folder in $(SCENES); do cp -rL "$$folder" "$(KIT)/scenes" || exit 1; done
	for folder in $(MODULES); do cp -rL "$$folder" "$(KIT)/modules" || exit 1; done
	$(if $(COMPARE),cp "$(COMPARE)/training.json" "$(KIT)/earlier.json")

gpu-kit: gpu-kit-folder ## pack what measures a GPU into one archive, for a machine without cargo; SCENES=, MODULES=folders, COMPARE=folder of an earlier report
	XZ_OPT=-T0 tar -C "$(dir $(KIT))" -cJf "$(KIT).tar.xz" "$(notdir $(KIT))"
	@bytes=$$(stat -c %s "$(KIT).tar.xz"); [ "$$bytes" -lt $$(($(KIT_MIB) << 20)) ] || { \
	  echo "gpu-kit: $(KIT).tar.xz has $$((bytes >> 20)) MiB, and no more than $(KIT_MIB) may be: leave scenes or modules out" >&2; exit 1; }; \
	  echo "$(KIT).tar.xz: $$((bytes >> 20)) MiB. Unpack it on the other machine, and run $(notdir $(KIT))/gpu-report."

gpu-report: gpu-kit-folder ## measure this machine's device, and write a folder to attach to an issue; MINUTES=8, and as gpu-kit
	rm -rf target/gpu-report
	"$(KIT)/gpu-report" -o target/gpu-report -m "$(MINUTES)"

# Groups are named after stages. Results, and how they were measured: docs/performance.md.
bench: ## benchmark every stage on this machine's Vulkan device; BENCH=group for one group
	cargo bench --locked --bench engine -- $(BENCH)

bench-quick: ## the same in a few minutes, with a wider spread
	QIRF_BENCH_QUICK=1 cargo bench --locked --bench engine -- $(BENCH)

# Everything is built before anything is measured. The measurements stay in target/figures until the next time.
FIGURES := target/figures
QIRF_BENCH_QUICK ?= 1
figures: ## measure, then rewrite the plots, renders and tables of README.md and docs/ (11 minutes on two idle cores)
	cargo build --release --locked --features figures --bins
	cargo bench --locked --bench engine --no-run
	rm -rf "$(FIGURES)"
	mkdir -p "$(FIGURES)"
	CRITERION_HOME="$(CURDIR)/$(FIGURES)/criterion" QIRF_BENCH_QUICK="$(QIRF_BENCH_QUICK)" cargo bench --locked --bench engine
	$(QIRF) synth "$(FIGURES)/demo"
	$(QIRF) sweep "$(FIGURES)/demo" -o "$(FIGURES)/sweep"
	@$(MAKE) --no-print-directory figures-written renders

# The tables and plots alone, from existing measurements.
figures-written:
	cargo run --release --locked --quiet --features figures --bin figures -- measured "$(FIGURES)/criterion" "$(FIGURES)/sweep/sweep.json" \
		"$$(git describe --always --dirty 2>/dev/null || echo unknown)" "make figures"

# Interrupted, it resumes where it stopped. SEEDS=1 ITERATIONS=2000 make results is a shorter look.
RESULTS ?= target/results
results: ## train and compare every scene with three seeds, then rewrite the tables of README.md and docs/results.md (hours)
	cargo build --release --locked --features figures --bins
	RESULTS="$(RESULTS)" tools/results
	@$(MAKE) --no-print-directory results-written

results-written:
	cargo run --release --locked --quiet --features figures --bin figures -- results "$(RESULTS)/compared" \
		"$$(git describe --always --dirty 2>/dev/null || echo unknown)" "make results"

viewer-speed: ## measure the viewer and what watching costs: the tables of docs/viewer.md; needs a quiet machine
	cargo build --release --locked
	QIRF_PROGRAM="$(CURDIR)/target/release/qirf-vk" cargo test --locked --test program view::speed -- --ignored --nocapture --test-threads 1 2>/dev/null | grep '^|'

# Needs Chromium.
page-of-a-million: ## open a page of a million Gaussians in Chromium (a minute)
	cargo test --locked --test program -- --ignored --nocapture a_page_of_a_million_opens

# RUN: folder of a run. Needs Chromium.
viewer-picture: ## rewrite the picture of docs/viewer.md; RUN=folder of a run
	QIRF_SUBJECT="$(RUN)" QIRF_PICTURE=docs/figures/viewer.jpg cargo test --locked --test program view::page::picture -- --ignored

# Both arms train equally long, so that the pictures differ by the prune alone.
renders: ## train the demo scene dense and pruned, and rewrite the three renders of README.md (ten minutes)
	$(QIRF) synth "$(FIGURES)/views" --size 360x270
	$(QIRF) compare "$(FIGURES)/views" -o "$(FIGURES)/compare" --preset quick --arms dense,default
	cargo run --release --locked --quiet --features figures --bin figures -- renders "$(FIGURES)/compare"
