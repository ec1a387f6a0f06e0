//! USD: our own layers and packages, those of other programs, and hostile ones.

use std::fs;
use std::io::Write;

use qirf_vk::gaussians::Gaussians;
use qirf_vk::gaussians::formats::{self, Format, Loaded, RenderMode};

use super::gltf::assert_near;
use super::readers::read;
use crate::support::files::make;

#[test]
fn layers_and_packages_are_read_back_to_the_last_bit_of_exponentials() {
    let folder = tempfile::tempdir().unwrap();
    for degree in 0..=3 {
        let mut model = make::model(5000, degree); // more than a block of text
        model.means[3] = [1e-9, -3e8, -0.0];
        for name in ["m.usda", "m.usdz"] {
            let path = folder.path().join(name);
            for mode in [RenderMode::AntiAliased, RenderMode::Plain] {
                formats::write(&path, &model, mode).unwrap();
                let loaded = formats::read(&path).unwrap();
                assert_eq!((loaded.format, loaded.mode, &loaded.doubt), (Format::Usd, mode, &None));
                assert_near(&loaded.gaussians, &model, 0.0);
            }
        }
    }
    let path = folder.path().join("empty.usda");
    formats::write(&path, &Gaussians::zeroed(0, 1), RenderMode::Plain).unwrap();
    assert_eq!(formats::read(&path).unwrap().doubt, None);
    // A package's file is stored uncompressed, and begins at a multiple of 64 bytes.
    let bytes = fs::read(folder.path().join("m.usdz")).unwrap();
    let start = bytes.windows(6).position(|w| w == b"#usda ").unwrap();
    assert_eq!(start % 64, 0);
}

/// A layer as other programs write them: nesting, metadata, comments, an `over`, halves, two prims.
const OTHER: &str = r#"#usda 1.0
(
    """A layer ( with brackets { and quotes"""
    upAxis = "Z"
    customLayerData = { dictionary a = { string b = "}" } }
)
# a comment ( [ {
def Xform "World" (
    prepend apiSchemas = ["A", "B"]
    customData = { string SplatRenderMode = "mip" }
)
{
    uniform token[] xformOpOrder = []
    float x.timeSamples = { 0: 1, 1: (2) }
    def ParticleField3DGaussianSplat "one"
    {
        custom string note = "def ParticleField3DGaussianSplat { ["
        point3h[] positionsh = [(1, 2, 3)]
        quath[] orientationsh = [(1, 0, 0, 0)]
        half3[] scalesh = [(1, 2.5e0, .5)]; half[] opacitiesh = [0.5]
        rel material:binding = </World/Looks>
        uniform int radiance:sphericalHarmonicsDegree = 0
        half3[] radiance:sphericalHarmonicsCoefficientsh = [(0.1, 0.2, 0.3)] (
            interpolation = "vertex"
        )
    }
    over "other" { point3f[] positions = [(9, 9, 9)] }
    def "untyped" { }
    def ParticleField3DGaussianSplat "two" { float3[] scales = [(1, 1, 1), (1,1,1)]
        float[] opacities = [0, 1]
        point3f[] positions = [(0, 0, 1), (0, 0, 2)]
        quatf[] orientations = [(1, 0, 0, 0), (0, 1, 0, 0)]
        int radiance:sphericalHarmonicsDegree = 1
        float3[] radiance:sphericalHarmonicsCoefficients = [(1,1,1),(0,0,0),(7,7,7),(0,0,0),(1,1,1),(0,0,0),(0,0,0),(0,0,0)]
    }
}
"#;

#[test]
fn layers_of_other_programs_are_read() {
    let loaded = read(OTHER.as_bytes(), "m.usda").unwrap();
    let m: Gaussians = loaded.gaussians;
    assert_eq!((m.len(), m.degree(), loaded.mode), (3, 1, RenderMode::AntiAliased));
    // Z up: our y points down, our z forward.
    let near = |a: [f32; 3], b: [f32; 3]| (0..3).all(|k| (a[k] - b[k]).abs() < 1e-6);
    assert!(near(m.means[0], [1.0, -3.0, 2.0]) && near(m.means[2], [0.0, -2.0, 0.0]), "{:?}", m.means);
    assert!(near(m.log_scales[0], [0.0, 2.5f32.ln(), 0.5f32.ln()]));
    assert_eq!((m.sh[0][1], loaded.repairs.clamped_opacities), (0.2, 2));
    // Brighter above: the coefficient of z becomes that of -y, with a changed sign.
    let row = &m.sh[1][9..18];
    assert!((row[0] - 7.0).abs() < 1e-5 && row[3].abs() < 1e-5, "{row:?}");
}

/// As in OpenUSD, also within values and in place of prims.
#[test]
fn comments_are_no_content() {
    let plain = read(OTHER.as_bytes(), "m.usda").unwrap().gaussians;
    let (values, hidden) = ("opacities = [0, 1]", "float[] opacities = [0.5, 0.5]");
    let prim = "def ParticleField3DGaussianSplat \"c\" { point3f[] positions = [(0, 0, 0)] }";
    for (from, to) in [
        ("def Xform", "// it's a comment\ndef Xform".to_owned()),
        ("def Xform", "/* { */ def Xform".to_owned()),
        (values, format!("opacities = [0, /* 5, */ 1] // {hidden}\n/* {hidden} */")),
        ("def \"untyped\" { }", format!("/* {prim}\n{prim} */")),
        (" = </World/Looks>", " /* none */ // none".to_owned()),
    ] {
        let text = OTHER.replace(from, &to);
        assert_ne!(text, OTHER);
        assert_eq!(read(text.as_bytes(), "m.usda").unwrap().gaussians, plain, "{to}");
    }
}

/// Operations act from the last to the first, then those of the prims around.
#[test]
fn transforms_move_turn_and_scale() {
    let mean = |operations: &str, order: &str| {
        let inner =
            format!("quath[] orientationsh = [(1, 0, 0, 0)]\n{operations}\nuniform token[] xformOpOrder = [{order}]");
        let text =
            OTHER.replace("quath[] orientationsh = [(1, 0, 0, 0)]", &inner).replace("upAxis = \"Z\"", "upAxis = \"Y\"");
        assert!(text.contains(&inner));
        read(text.as_bytes(), "m.usda").map(|loaded| {
            let [x, y, z] = loaded.gaussians.means[0].map(f64::from);
            // In the layer's axes, and its world.
            [x + loaded.origin[0], -(y + loaded.origin[1]), -(z + loaded.origin[2])].map(|v| (v * 1e5).round() / 1e5)
        })
    };
    let all = "double3 xformOp:translate = (10, 0, 0)\nfloat3 xformOp:rotateXYZ = (90, 0, 90)\nfloat3 xformOp:scale = (2, 2, 2)\n\
               double3 xformOp:translate:pivot = (1, 2, 3)\nquatf xformOp:orient = (1, 0, 0, 1)\nfloat xformOp:rotateY = 90\n\
               matrix4d xformOp:transform = ((0, 2, 0, 0), (-2, 0, 0, 0), (0, 0, 2, 0), (5, 6, 7, 1))\n\
               double3 xformOp:translate:far = (500000, 4000000.5, 0)\nfloat3 xformOp:scale:flat = (1, 1, 2)\n\
               double xformOp:translateX = 4\ndouble xformOp:translateZ:up = 5\nfloat xformOp:scaleX = 2\nfloat xformOp:scaleY = 2\n\
               float xformOp:scaleZ = 2\ndouble3 xformOp:translate:unset\nfloat xformOp:rotateX:blocked = None\n\
               double3 xformOp:translate:moves\ndouble3 xformOp:translate:moves.timeSamples = { 1: (3, 0, 0) }";
    for (order, [x, y, z]) in [
        ("\"xformOp:translate\", \"xformOp:scale\"", [12.0, 4.0, 6.0]),
        ("\"xformOp:scale\", \"xformOp:translate\"", [22.0, 4.0, 6.0]),
        // (1, 2, 3) about x to (1, -3, 2), about z to (3, 1, 2).
        ("\"xformOp:rotateXYZ\"", [3.0, 1.0, 2.0]),
        ("\"!invert!xformOp:translate:pivot\"", [0.0, 0.0, 0.0]),
        ("\"xformOp:translate:pivot\", \"xformOp:rotateY\", \"!invert!xformOp:translate:pivot\"", [1.0, 2.0, 3.0]),
        ("\"xformOp:orient\"", [-2.0, 1.0, 3.0]),
        ("\"xformOp:rotateY\"", [3.0, 2.0, -1.0]),
        ("\"xformOp:transform\"", [1.0, 8.0, 13.0]),
        ("\"xformOp:translate:far\"", [500_001.0, 4_000_002.5, 3.0]),
        ("\"xformOp:translateX\", \"xformOp:translateZ:up\"", [5.0, 2.0, 8.0]),
        ("\"xformOp:scaleX\", \"xformOp:scaleY\", \"xformOp:scaleZ\"", [2.0, 4.0, 6.0]),
        ("\"xformOp:translate:unset\", \"xformOp:rotateX:blocked\", \"xformOp:scale\"", [2.0, 4.0, 6.0]),
        ("\"xformOp:translate\", \"!resetXformStack!\", \"xformOp:scale\"", [2.0, 4.0, 6.0]),
    ] {
        assert_eq!(mean(all, order).unwrap(), [x, y, z], "{order}");
    }
    for (order, what) in [
        ("\"xformOp:scale:flat\"", "different factors"),
        ("\"xformOp:rotateW\"", "rotateW"),
        ("\"xformOp:scaleY\"", "different factors"),
        ("\"xformOp:translate:moves\"", "translate:moves"),
    ] {
        let fault = mean(all, order).unwrap_err().to_string();
        assert!(fault.contains(what), "{order}: {fault}");
    }
}

/// The prims around do not move one that resets its transform; a root may say so too.
#[test]
fn a_reset_leaves_the_transforms_around_out() {
    let moved = |around: &str, own: &str| {
        let around = format!("double3 xformOp:translate = (100, 0, 0)\nuniform token[] xformOpOrder = [{around}]");
        let own = format!("uniform token[] xformOpOrder = [{own}]\npoint3h[] positionsh");
        let text = OTHER.replace("uniform token[] xformOpOrder = []", &around).replace("point3h[] positionsh", &own);
        let means = read(text.as_bytes(), "m.usda").unwrap().gaussians.means;
        [means[0][0], means[1][0]]
    };
    let (translate, reset) = ("\"xformOp:translate\"", "\"!resetXformStack!\"");
    assert_eq!(moved(translate, ""), [101.0, 100.0]);
    assert_eq!(moved(translate, reset), [1.0, 100.0]);
    assert_eq!(moved(&format!("{reset}, {translate}"), ""), [101.0, 100.0]);
}

#[test]
fn prims_far_apart_are_told() {
    let place = "double3 xformOp:translate = (500000, 0, 0)\nuniform token[] xformOpOrder = [\"xformOp:translate\"]";
    let text = OTHER.replace("float[] opacities = [0, 1]", &format!("float[] opacities = [0, 1]\n{place}"));
    let doubt = read(text.as_bytes(), "m.usda").unwrap().doubt.unwrap();
    assert!(doubt.contains("a prim lies far") && doubt.contains("about 6.0e-2 units"), "{doubt}");
}

#[test]
fn layers_are_read_as_their_schema_says() {
    let changed = |from: &str, to: &str| {
        assert!(OTHER.contains(from), "{from}");
        read(OTHER.replace(from, to).as_bytes(), "m.usda")
    };
    let (half, float) = ("point3h[] positionsh = [(1, 2, 3)]", "point3f[] positions = [(4, 2, 3)]");
    for both in [format!("{half}\n{float}"), format!("{float}\n{half}")] {
        let means = changed(half, &both).unwrap().gaussians.means;
        assert!((means[0][0] - 4.0).abs() < 1e-6, "float counts: {means:?}");
    }
    for (value, told) in
        [("", true), ("half3[] scalesh = None", true), ("half3[] scalesh = [(1, 1, 1), (2, 2, 2)]", false)]
    {
        let loaded = changed("half3[] scalesh = [(1, 2.5e0, .5)];", value).unwrap();
        assert_eq!((loaded.gaussians.log_scales[0], loaded.doubt.is_some()), ([0.0; 3], told), "{value}");
    }
    let grey =
        changed("half3[] radiance:sphericalHarmonicsCoefficientsh = [(0.1, 0.2, 0.3)]", "float other = 1").unwrap();
    assert_eq!(grey.gaussians.sh[0][..3], [0.0; 3]);

    // A stage does not show these prims.
    let two = "def ParticleField3DGaussianSplat \"two\" {";
    for hidden in [
        two.replace(" {", " (active = false) {"),
        two.replace("def", "class"),
        two.replace("def", "over"),
        two.replace('{', "{ token visibility = \"invisible\"\n"),
        two.replace('{', "{ uniform token purpose = \"proxy\"\n"),
    ] {
        assert_eq!(changed(two, &hidden).unwrap().gaussians.len(), 1, "{hidden}");
    }
    let untyped = "def \"untyped\" { }";
    let inner = "{ def ParticleField3DGaussianSplat \"c\" { point3f[] positions = [(0, 0, 0)] } }";
    for (prim, shown) in [
        ("def \"a\" (kind = \"group\")", true),
        ("def \"a\" (active = false)", false),
        ("class \"a\" (kind = \"group\")", false),
        ("over \"a\"", false),
        ("def \"a\" (customData = { bool active = 0 })", true),
    ] {
        let loaded = changed(untyped, &format!("{prim} {inner}")).unwrap();
        assert_eq!(loaded.gaussians.len(), 3 + usize::from(shown), "{prim}");
    }
    // A prim's own purpose counts, else that of the prim around it.
    for (around, own, shown) in [("guide", "", false), ("guide", "default", true), ("render", "proxy", false)] {
        let purpose = |purpose: &str| format!("uniform token purpose = \"{purpose}\"\n");
        let own = if own.is_empty() { String::new() } else { purpose(own) };
        let inner = inner.replace("point3f", &format!("{own}point3f"));
        let outer = format!("def \"a\" {{ {}{}", purpose(around), &inner[1..]);
        let loaded = changed(untyped, &outer).unwrap();
        assert_eq!(loaded.gaussians.len(), 3 + usize::from(shown), "{outer}");
    }
    let within = "def \"untyped\" { variantSet \"v\" = { \"a\" { def ParticleField3DGaussianSplat \"b\" { point3f[] positions = [] } } } }";
    assert!(changed(untyped, within).unwrap_err().to_string().contains("variant"));
    // Other layers are not read.
    for arc in ["prepend references = @a.usda@</A>", "payload = [@a.usda@, @b.usda@]", "inherits = </A>"] {
        let doubt = changed(untyped, &format!("def \"a\" ({arc}) {{ }}")).unwrap().doubt.unwrap();
        assert!(doubt.contains("refers to other layers"), "{arc}: {doubt}");
        let alone = format!("#usda 1.0\ndef \"a\" (\n    {arc}\n) {{ }}");
        let fault = read(alone.as_bytes(), "m.usda").unwrap_err().to_string();
        assert!(fault.contains("refers to other layers") && !fault.contains("holds no"), "{arc}: {fault}");
    }
    let layers = read(b"#usda 1.0\n( subLayers = [@a.usda@] )", "m.usda").unwrap_err().to_string();
    assert!(layers.contains("usdcat --flatten"), "{layers}");
    let none = changed(untyped, "def \"a\" (references = None customData = { string payload = \"p\" }) { }").unwrap();
    assert_eq!(none.doubt, None);
    let tagged = two.replace(" {", " (customData = { string SplatRenderMode = \"default\" }) {");
    let mixed = changed(two, &tagged).unwrap();
    assert!(mixed.mode.antialiased() && mixed.doubt.unwrap().contains("different render modes"));
}

/// Positions and sizes are in metres where the layer states its unit; other metadata of the same names does not count.
#[test]
fn the_unit_and_the_axis_are_those_of_the_layer() {
    let with = |layer: &str, of_prim: &str| {
        let text =
            OTHER.replace("upAxis = \"Z\"", layer).replace("{ string Splat", &format!("{{ {of_prim} string Splat"));
        read(text.as_bytes(), "m.usda").unwrap()
    };
    for (layer, of_prim, size, told) in [
        ("upAxis = \"Y\"", "double metersPerUnit = 5 string upAxis = \"Z\"", 1.0_f32, None),
        ("upAxis = \"Y\"\n    customLayerData = { string upAxis = \"Z\" }", "", 1.0, None),
        ("metersPerUnit = 1", "", 1.0, None),
        ("metersPerUnit = 1e-2", "", 0.01, Some("its unit is 0.01 m")),
        ("metersPerUnit = 0", "", 1.0, Some("is no length")),
    ] {
        let Loaded { gaussians, doubt, .. } = with(layer, of_prim);
        let mean = [1.0, -2.0, -3.0].map(|x: f32| x * size);
        assert!((0..3).all(|k| (gaussians.means[0][k] - mean[k]).abs() < 1e-6), "{layer}: {:?}", gaussians.means);
        assert!((gaussians.log_scales[0][0] - size.ln()).abs() < 1e-5, "{layer}");
        assert_eq!(doubt.is_some(), told.is_some(), "{layer}: {doubt:?}");
        assert!(told.is_none_or(|told| doubt.unwrap().contains(told)), "{layer}");
    }
}

#[test]
fn time_samples_beside_a_default_value_are_told() {
    let plain = read(OTHER.as_bytes(), "m.usda").unwrap().gaussians;
    let positions = "point3f[] positions = [(0, 0, 1), (0, 0, 2)]";
    let moves = "double3 xformOp:translate.timeSamples = { 1: (3, 0, 0), 24: (6, 0, 0) }";
    let still = "double3 xformOp:translate = (0, 0, 0)\nuniform token[] xformOpOrder = [\"xformOp:translate\"]";
    let both = format!("{still}\n{moves}");
    for (samples, told) in [
        ("point3f[] positions.timeSamples = { 1: [(5, 5, 5), (6, 6, 6)] }", Some("samples of positions,")),
        ("token visibility.timeSamples = { 1: \"invisible\" }", Some("samples of visibility,")),
        (both.as_str(), Some("prim two has time samples of xformOp:translate,")),
        (moves, None),
        ("float x.timeSamples = { 1: 2 }", None),
    ] {
        let text = OTHER.replace(positions, &format!("{positions}\n{samples}\n"));
        let loaded = read(text.as_bytes(), "m.usda").unwrap();
        assert_eq!(loaded.gaussians, plain, "{samples}");
        assert_eq!(loaded.doubt.is_some(), told.is_some(), "{samples}: {:?}", loaded.doubt);
        assert!(told.is_none_or(|told| loaded.doubt.unwrap().contains(told)), "{samples}");
    }
    // Also those of a prim around, whatever the tag of the prim within says.
    let tag = "ParticleField3DGaussianSplat \"two\" (customData = { string SplatRenderMode = \"mip\" }) {";
    let text = OTHER
        .replace("float x.timeSamples", "token visibility.timeSamples")
        .replace("ParticleField3DGaussianSplat \"two\" {", tag);
    let doubt = read(text.as_bytes(), "m.usda").unwrap().doubt.unwrap();
    assert!(doubt.contains("prim World has time samples of visibility"), "{doubt}");
}

#[test]
fn all_faults_of_a_layer_are_told() {
    let text = OTHER
        .replace("half3[] scalesh = [(1, 2.5e0, .5)];", "")
        .replace("def \"untyped\"", "def \"a\" (payload = @a.usda@)");
    let doubt = read(text.as_bytes(), "m.usda").unwrap().doubt.unwrap();
    assert!(doubt.contains("refers to other layers") && doubt.contains("; also prim one has no scales"), "{doubt}");
    let hidden = OTHER.replace("def Xform \"World\" (", "def Xform \"World\" (\n    active = false");
    let fault = read(hidden.as_bytes(), "m.usda").unwrap_err().to_string();
    assert!(fault.contains("no visible prim of type") && fault.contains("inactive"), "{fault}");
}

#[test]
fn hostile_layers_are_refused() {
    let said = |text: &str, name: &str| read(text.as_bytes(), name).unwrap_err().to_string();
    for (from, to, what) in [
        ("positionsh = [(1, 2, 3)]", "positionsh = [(1, 2)]", "numbers of"),
        ("positionsh = [(1, 2, 3)]", "positionsh = [(1, 2, x)]", "no number"),
        ("positionsh = [(1, 2, 3)]", "positionsh.timeSamples = { 0: [(1, 2, 3)] }", "positions only in time samples"),
        ("positionsh = [(1, 2, 3)]", "place = [(1, 2, 3)]", "has no positions"),
        ("scalesh = [(1, 2.5e0, .5)]", "scalesh.timeSamples = { 0: [(1, 1, 1)] }", "scales only in time samples"),
        ("opacities = [0, 1]", "opacities = [0]", "1 numbers of opacities"),
        ("Degree = 1", "Degree = 4", "SH degree 4"),
        ("Degree = 1", "Degree = 2", "numbers of spherical harmonics"),
        ("Degree = 1", "Degree = 0", "numbers of spherical harmonics"),
        ("Order = []", "Order = [\"xformOp:scale\"]", "has the transform"),
        ("ParticleField3DGaussianSplat \"", "Mesh \"", "holds no Gaussians"),
    ] {
        let fault = said(&OTHER.replace(from, to), "m.usda");
        assert!(fault.contains(what), "{to}: {fault}");
    }
    assert!(said(&format!("#usda 1.0\n{}", "def A \"b\" {".repeat(2000)), "m.usda").contains("too deeply"));
    assert!(said(&format!("#usda 1.0\n({}", "[".repeat(100_000)), "m.usda").contains("ends within"));
    assert!(said("#usda 1.0\n}", "m.usda").contains("not opened"));
    assert!(said("PXR-USDC\0\0", "m.usdc").contains("usdcat"));
    assert!(said("solid", "m.usda").contains("begins with `#usda`"));
    for end in (0..OTHER.len() - 2).step_by(3) {
        let cut = OTHER.as_bytes().get(..end).unwrap();
        if let Ok(loaded) = read(cut, "m.usda") {
            panic!("cut at {end}: {} Gaussians", loaded.gaussians.len());
        }
    }
}

/// A package of one layer with this name.
fn packed(name: &str, method: zip::CompressionMethod) -> Vec<u8> {
    let mut archive = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    archive.start_file(name, zip::write::SimpleFileOptions::default().compression_method(method)).unwrap();
    archive.write_all(OTHER.as_bytes()).unwrap();
    archive.finish().unwrap().into_inner()
}

#[test]
fn packages_whose_layer_lies_elsewhere_are_refused() {
    let stored = |name: &str| read(&packed(name, zip::CompressionMethod::Stored), "m.usdz");
    for name in ["./0/a..b.usda", "a\\b.usda"] {
        assert!(stored(name).is_ok(), "{name}");
    }
    for name in ["../../splat.usda", "a/../../b.usda", "/a.usda", "..\\a.usda", "\\a.usda", "C:a.usda", "c:/a.usda"] {
        let fault = stored(name).unwrap_err().to_string();
        let shown = format!("`{}`", name.replace('\\', "\\\\"));
        assert!(fault.contains("m.usdz") && fault.contains(&shown), "{name}: {fault}");
    }
}

#[test]
fn packages_with_compressed_files_are_refused() {
    for method in [zip::CompressionMethod::Deflated, zip::CompressionMethod::Stored] {
        let bytes = packed("a.usda", method);
        assert_eq!(read(&bytes, "m.usdz").is_ok(), method == zip::CompressionMethod::Stored);
        let mut damaged = bytes;
        let at = damaged.windows(5).position(|w| w == b"#usda");
        if let Some(at) = at {
            damaged[at + 9] ^= 2;
            assert!(read(&damaged, "m.usdz").unwrap_err().to_string().contains("checksum"));
        }
    }
    assert!(read(b"PK\x03\x04", "m.usdz").is_err());
}
