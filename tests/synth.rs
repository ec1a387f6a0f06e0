//! t
use qirf_vk::synth::*;
#[test]
#[ignore = "by hand"]
fn by_hand() {
    let dir = std::env::var("SYNTH_DIR").unwrap();
    let mut o = SynthOptions::default();
    if let Ok(e) = std::env::var("SYNTH_EFFECTS") {
        o.effects = e.split(',').map(|x| x.parse().unwrap()).collect();
    }
    if let Ok(e) = std::env::var("SYNTH_VIEWS") {
        o.views = e.parse().unwrap();
    }
    if let Ok(e) = std::env::var("SYNTH_W") {
        o.width = e.parse().unwrap();
        o.height = o.width * 3 / 4;
    }
    let t = std::time::Instant::now();
    let r = write(std::path::Path::new(&dir), &o, &|_| ()).unwrap();
    println!("{r:?} {:?}", t.elapsed());
}
