//! The results of `qirf-vk sweep`, from its `sweep.json`: a full table, plots, and a short table of what exactness
//! costs.

use super::Origin;
use super::measured::json;
use super::tables::{digits, table};
use qirf_vk::lab::sweep::records::figure;
use qirf_vk::report::format::{NONE, count, decimals};
use qirf_vk::report::plot::{Accuracies, Axis as Scale, Front, Point, sheet};
use serde_json::Value;
use std::path::Path;

/// The version of `sweep.json` that this reads.
const SCHEMA: u64 = 1;
/// Times within this share of each other count as equal.
const EQUAL: f64 = 0.03;

pub struct Sweep(Value);

impl Sweep {
    /// Reads the file.
    ///
    /// # Errors
    /// A file that is absent, not JSON, of another schema, or without axes.
    pub fn read(path: &Path) -> Result<Self, String> {
        let value = json(path)?;
        if value["schema"].as_u64() != Some(SCHEMA) {
            return Err(format!("{}: schema {}, {SCHEMA} is read; sweep again", path.display(), value["schema"]));
        }
        if value["axes"].as_array().is_none_or(Vec::is_empty) {
            return Err(format!("{}: no axes were climbed; sweep without --axis", path.display()));
        }
        Ok(Self(value))
    }

    fn axes(&self) -> &[Value] {
        rows(&self.0["axes"])
    }

    fn axis(&self, name: &str) -> Option<&Value> {
        self.axes().iter().find(|a| a["axis"] == name)
    }

    fn rung(&self, axis: &str, rung: &str) -> Option<&Value> {
        rows(&self.axis(axis)?["rungs"]).iter().find(|r| r["name"] == rung)
    }

    /// All rungs, the cost of the next more exact one, the reason why an axis is flat, and the subject measured.
    pub fn table(&self) -> String {
        let subject = &self.0["subject"];
        let mut out = format!(
            "{} Gaussians, SH degree {}: {}. {} views of {} x {}; {}; {} s in total.\n\n",
            count(subject["gaussians"].as_u64().unwrap_or(0) as usize),
            subject["degree"],
            text(&subject["origin"]).trim_end_matches('.'),
            subject["views"],
            subject["size"][0],
            subject["size"][1],
            text(&self.0["device"]["name"]),
            decimals(self.0["seconds"].as_f64(), 0),
        );
        let mut lines = Vec::new();
        for axis in self.axes() {
            let mut name = format!("**{}**", text(&axis["axis"]));
            let mut unit = format!("{}; {}", text(&axis["time"]), text(&axis["accuracy"]));
            for rung in rows(&axis["rungs"]) {
                let quartiles =
                    ["median", "q1", "q3"].map(|k| rung["time"][k].as_f64().map_or(NONE.to_owned(), digits));
                let [median, q1, q3] = quartiles;
                let mark = |on: &str| if rung[on] == true { "yes" } else { "" };
                lines.push(vec![
                    std::mem::take(&mut name),
                    std::mem::take(&mut unit),
                    if rung["default"] == true {
                        format!("**{}**", text(&rung["name"]))
                    } else {
                        text(&rung["name"]).to_owned()
                    },
                    mark("front").to_owned(),
                    format!("{median} [{q1}..{q3}]"),
                    shown(rung),
                ]);
            }
        }
        out += &table(&["axis", "measures of time; accuracy", "rung", "Pareto front", "time", "accuracy"], 4, &lines);
        out.push('\n');
        for axis in self.axes() {
            let told = [&axis["sentence"]].into_iter().chain(rows(&axis["flat"])).chain(rows(&axis["notes"]));
            let told: Vec<&str> = told.map(text).collect();
            out += &format!("* {}: {}\n", text(&axis["axis"]), told.join(" "));
        }
        if let Some(rung) = self.rung("solver", "low-rank") {
            let of = |name: &str| rung["figures"][name].as_f64();
            out += &format!(
                "\nAt m = 256 low-rank is {} times as fast as dsygvd; the Jaccard index of the sets kept is {}.\n",
                decimals(of("speedup_m256"), 1),
                decimals(of("kept_jaccard_m256"), 4)
            );
        }
        out + "\n![Accuracy against time](figures/sweep.svg)\n"
    }

    /// The cost of exactness, one row per choice; choices without rungs on this device are left out.
    pub fn exactness(&self, origin: &Origin) -> String {
        let rows = [self.gradients(), self.overlaps(), self.solver(), self.culling()];
        let rows: Vec<Vec<String>> = rows.into_iter().flatten().map(Vec::from).collect();
        format!(
            "Measured on the demo scene; {}, {} threads, commit {} ([full tables](performance.md#sweep)).\n\n{}\n\
             ![Accuracy against time on four axes](figures/exactness.svg)\n",
            text(&self.0["device"]["name"]),
            self.0["host_threads"],
            origin.commit,
            table(&["default", "compared with", "time", "what you get"], 4, &rows)
        )
    }

    fn time(&self, axis: &str, rung: &str) -> Option<f64> {
        self.rung(axis, rung)?["time"]["median"].as_f64()
    }

    fn gradients(&self) -> Option<[String; 4]> {
        let (ordered, atomic) = (self.time("gradients", "ordered")?, self.time("gradients", "atomics")?);
        let time = format!("{} ms per iteration (float atomics: {} ms)", digits(ordered), digits(atomic));
        Some(choice("gradients summed in a fixed order", "float atomics", time, "the same bits on every run"))
    }

    fn overlaps(&self) -> Option<[String; 4]> {
        let [qr, other] = ["qr", "determinant"].map(|name| self.rung("overlap", name));
        let flat = other?["figures"]["flat_nan_share"].as_f64().unwrap_or(0.0);
        let gained = format!(
            "largest error {} (determinant: {}){}",
            shown(qr?),
            shown(other?),
            if flat > 0.0 { "; no NaN, which the determinant yields for flat Gaussians" } else { "" }
        );
        let time = compared(self.time("overlap", "qr")?, self.time("overlap", "determinant")?);
        Some(choice("overlaps by QR", "by determinant", time, &gained))
    }

    fn solver(&self) -> Option<[String; 4]> {
        let own = self.time("solver", "low-rank")?;
        let same = self.rung("solver", "low-rank")?["figures"]["kept_jaccard"] == 1.0;
        let gained = format!(
            "{} LAPACK's general solver, which takes {} times as long",
            if same { "the same kept set as" } else { "nearly the kept set of" },
            decimals(self.time("solver", "dsygvd")? / own, 1)
        );
        let time = compared(own, self.time("solver", "low-rank-f32")?);
        Some(choice("eigenproblems in float64", "in float32", time, &gained))
    }

    fn culling(&self) -> Option<[String; 4]> {
        let exact = self.rung("culling", "exact")?;
        let time = format!(
            "{} ms per frame (boxes: {} ms)",
            digits(self.time("culling", "exact")?),
            digits(self.time("culling", "3-sigma")?)
        );
        let gained = match exact["accuracy"].as_f64() {
            Some(0.0) => "no pixel differs".to_owned(),
            _ => format!("pixels differ by at most {}", shown(exact)),
        };
        Some(choice("exact ellipse-tile test", "boxes of three sigma", time, &gained))
    }

    /// Accuracy against time, side by side, on those of these axes that exist.
    pub fn plot(&self, names: &[&str], columns: usize) -> String {
        let drawings: Vec<_> =
            names.iter().filter_map(|name| self.axis(name)).map(|axis| front(axis).drawing()).collect();
        sheet(&format!("Accuracy against time: {}", names.join(", ")), &drawings, columns)
    }
}

fn rows(value: &Value) -> &[Value] {
    value.as_array().map_or(&[], Vec::as_slice)
}

fn text(value: &Value) -> &str {
    value.as_str().unwrap_or(NONE)
}

/// A rung's accuracy as text.
fn shown(rung: &Value) -> String {
    match rung["accuracy"].as_f64() {
        Some(a) => figure(a),
        None if rung["exact"] == true => "exact".to_owned(),
        None => NONE.to_owned(),
    }
}

/// A row of the short table.
fn choice(default: &str, other: &str, time: String, gained: &str) -> [String; 4] {
    [default.to_owned(), other.to_owned(), time, gained.to_owned()]
}

fn compared(time: f64, other: f64) -> String {
    match time / other - 1.0 {
        d if d.abs() < EQUAL => "equal".to_owned(),
        d if d > 0.0 => format!("{:.0} % longer", 100.0 * d),
        d => format!("{:.0} % shorter", -100.0 * d),
    }
}

/// Drawn as on the sweep's own page.
fn front(axis: &Value) -> Front<'_> {
    let rungs = rows(&axis["rungs"]);
    let measured: Vec<f64> = rungs.iter().filter_map(|r| r["accuracy"].as_f64()).collect();
    let accuracies = Accuracies::new(&measured, axis["better"] == "lower");
    let point = |rung: &Value| {
        let y = accuracies.place(rung["accuracy"].as_f64(), rung["exact"] == true)?;
        let of = |name: &str| rung["time"][name].as_f64();
        // Rungs whose zero error has no place on a logarithmic axis.
        let equal = y == accuracies.beyond && rung["name"] != "exact";
        Some(Point {
            label: format!("{}{}", text(&rung["name"]), if equal { " (exact)" } else { "" }),
            told: format!("{}: {}", text(&rung["name"]), shown(rung)),
            at: [of("median")?, y],
            spread: [of("q1")?, of("q3")?],
            front: rung["front"] == true,
            default: rung["default"] == true,
        })
    };
    let points: Vec<Point> = rungs.iter().filter_map(point).collect();
    let times: Vec<f64> = points.iter().map(|p| p.at[0]).collect();
    Front {
        title: text(&axis["title"]),
        x: Scale::from_zero(text(&axis["time"])).or_log(&times),
        y: accuracies.axis(text(&axis["accuracy"])),
        legend: &["on the Pareto front", "not on the front; ring: default"],
        points,
    }
}
