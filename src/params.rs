//! The knobs: one table, and the values of one frame.
//!
//! From [`KNOBS`] come parsing, checking, the listing of `params` and the record in a frame's JSON.
//! Must not know: what a knob does.
//! To add a knob: a row in the table below, and the line that uses it.

pub mod distribution;
pub mod sampler;

use serde_json::{Map, Value as Json};

use crate::error::{Error, Result, nearest};
use crate::random::Stream;
use Distribution::{Fixed, Power, Uniform, UniformInt};
use Kind::{Integer, Number, Rgb, Text};
use Scope::{Element, Frame};
pub use distribution::{Distribution, Value};

/// What sort of value a knob takes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    /// Any number in the range.
    Number,
    /// A whole number in the range.
    Integer,
    /// A colour, each channel in the range.
    Rgb,
    /// One of these words.
    Text(&'static [&'static str]),
}

/// How often a knob is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scope {
    /// Once a frame.
    Frame,
    /// Once for each of these.
    Element(&'static str),
}

/// A stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// The reference stage: simple and exactly specified.
    Nominal,
    /// The realistic ground.
    Surface,
}

impl Stage {
    /// Every stage with its name.
    pub const ALL: [(Self, &'static str); 2] = [(Self::Nominal, "nominal"), (Self::Surface, "surface")];

    /// Its name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        Self::ALL[self as usize].1
    }

    /// The stage of a name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|(_, known)| *known == name).map(|(stage, _)| stage)
    }
}

/// All that is known of a knob.
#[derive(Debug)]
pub struct KnobInfo {
    /// Dotted name.
    pub name: &'static str,
    /// Unit, empty for none.
    pub unit: &'static str,
    /// What it takes.
    pub kind: Kind,
    /// How often it is drawn.
    pub scope: Scope,
    /// The stage that it belongs to; none for those of every stage.
    pub stage: Option<Stage>,
    /// Its default.
    pub default: Distribution,
    /// Its default on the surface stage, where that is another one.
    pub surface_default: Option<Distribution>,
    /// Smallest and largest allowed number.
    pub range: [f64; 2],
    /// What it does.
    pub doc: &'static str,
}

const fn number(value: f64) -> Distribution {
    Distribution::number(value)
}

const fn word(text: &'static str) -> Distribution {
    Fixed(Value::Text(std::borrow::Cow::Borrowed(text)))
}

const fn uniform(low: f64, high: f64) -> Distribution {
    Uniform { low, high }
}

macro_rules! knobs {
    ($($knob:ident $name:literal $unit:literal $(in $stage:ident)? $kind:expr, $scope:expr, $default:expr
        $(=> $surface:expr)?, $range:expr, $doc:literal;)*) => {
        /// Every knob, by its place in [`KNOBS`].
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum Knob { $(#[doc = $doc] $knob,)* }

        /// Every knob.
        pub static KNOBS: [KnobInfo; [$($name),*].len()] = [$(KnobInfo {
            name: $name, unit: $unit, kind: $kind, scope: $scope,
            stage: knobs!(@or_none $(Stage::$stage)?),
            default: $default,
            surface_default: knobs!(@or_none $($surface)?),
            range: $range, doc: $doc,
        },)*];

        impl Knob {
            /// Every knob, in the order of [`KNOBS`].
            pub const ALL: [Self; KNOBS.len()] = [$(Self::$knob,)*];
        }
    };
    (@or_none) => { None };
    (@or_none $value:expr) => { Some($value) };
}

knobs! {
    StageName "stage.name" "" Text(&["nominal", "surface"]), Frame, word("nominal"), [0.0, 0.0],
        "Which stage is built.";
    SunElevationDeg "sun.elevation_deg" "deg" Number, Frame, number(17.0) => number(13.0), [0.5, 90.0],
        "Angle of the sun above the horizontal plane.";
    SunAzimuthDeg "sun.azimuth_deg" "deg" Number, Frame, number(120.0) => number(135.0), [0.0, 360.0],
        "Compass angle of the sun from +Y, where the camera looks, towards +X: 0 is in front of the camera.";
    SunIntensity "sun.intensity" "" Number, Frame, number(14_000.0) => number(3500.0), [0.0, 200_000.0],
        "Strength of the sun on a relative scale; the reference frame has 14000.";
    SunAngularDiameterDeg "sun.angular_diameter_deg" "deg" Number, Frame, number(0.53), [0.0, 5.0],
        "Angle that the sun's disc spans: how fast penumbrae widen.";
    SunColor "sun.color" "" Rgb, Frame, Fixed(Value::Rgb([1.0, 0.97, 0.92])) => Fixed(Value::Rgb([1.0, 1.0, 1.0])), [0.0, 4.0],
        "Colour of the sun's light, linear RGB.";
    TerrainAmplitudeM "terrain.amplitude_m" "m" in Nominal Number, Frame, number(3.2), [0.0, 50.0],
        "Amplitude of the relief; its standard deviation is about a quarter of it.";
    TerrainSizeM "terrain.size_m" "m" Number, Frame, number(920.0) => number(2400.0), [100.0, 4000.0],
        "Side of the square of ground, centred on the origin.";
    TerrainCells "terrain.cells" "" in Nominal Integer, Frame, number(300.0), [10.0, 1000.0],
        "Cells along a side of the ground's grid, two triangles each.";
    TerrainCellMrad "terrain.cell_mrad" "mrad" in Surface Number, Frame, number(12.0), [2.0, 50.0],
        "Angle that a cell of the ground's mesh spans seen from the camera; detail below it is in the shading.";
    ReliefHillsM "relief.hills_m" "m" in Surface Number, Frame, number(9.0), [0.0, 60.0],
        "Amplitude of hills 250 m long and shorter; their standard deviation is about a sixth of it.";
    ReliefUndulationM "relief.undulation_m" "m" in Surface Number, Frame, number(2.4), [0.0, 20.0],
        "Amplitude of waves 50 m long and shorter; their standard deviation is about a sixth of it.";
    ReliefSlopeDeg "relief.slope_deg" "deg" in Surface Number, Frame, number(10.0), [0.0, 25.0],
        "Median slope of the fine relief between places 7 mm apart (Guo et al. 2021: 10 at the site of Chang'e-4).";
    ReliefHurst "relief.hurst" "" in Surface Number, Frame, number(0.75), [0.4, 1.0],
        "Hurst exponent of the fine relief: 1 is smooth when looked at closely (Guo et al. 2021: 0.6 to 0.85).";
    ReliefClods "relief.clods" "" in Surface Number, Frame, number(0.5), [0.0, 1.0],
        "Share of clods among the pits and clods of up to 8 cm.";
    RegolithAlbedo "regolith.albedo" "" Number, Frame, number(0.205) => number(0.12), [0.0, 1.0],
        "Mean diffuse reflectance of the ground.";
    RegolithRoughness "regolith.roughness" "" Number, Frame, number(0.96), [0.0, 1.0],
        "Roughness of the ground's diffuse lobe; 0 is Lambert's.";
    RegolithRedOverGreen "regolith.red_over_green" "" in Surface Number, Frame, number(1.05), [0.5, 2.0],
        "Colour of the soil: red over green, linear; lunar soil has 1.00 to 1.12.";
    RegolithBlueOverGreen "regolith.blue_over_green" "" in Surface Number, Frame, number(0.88), [0.3, 2.0],
        "Colour of the soil: blue over green, linear; lunar soil has 0.72 to 0.95.";
    CratersCount "craters.count" "" in Nominal Integer, Frame, UniformInt { low: 6.0, high: 10.0 }, [0.0, 500.0],
        "Number of craters.";
    CratersRadiusM "craters.radius_m" "m" in Nominal Number, Element("crater"), uniform(10.0, 38.0), [0.5, 400.0],
        "Radius of a crater from its centre to the crest of its rim.";
    CratersDepthM "craters.depth_m" "m" in Nominal Number, Element("crater"), uniform(1.5, 5.5), [0.0, 60.0],
        "Depth of a crater's bowl below the ground around it.";
    CratersRimRatio "craters.rim_ratio" "" in Nominal Number, Element("crater"), uniform(0.18, 0.35), [0.0, 1.0],
        "Height of a crater's rim as a fraction of its depth.";
    CratersLaw "craters.law" "" in Surface Text(&["equilibrium", "classes"]), Frame, word("equilibrium"), [0.0, 0.0],
        "How many craters there are of more than 1.25 m: as impacts and wear leave them, or three counted classes.";
    CratersBigCount "craters.big_count" "" in Surface Integer, Frame, number(7.0), [0.0, 100.0],
        "With the law classes: craters of 14 to 40 m radius, on a square of 766 m around the origin.";
    CratersMediumCount "craters.medium_count" "" in Surface Integer, Frame, number(42.0), [0.0, 1000.0],
        "With the law classes: craters of 3 to 12 m radius, on the same square.";
    CratersSmallCount "craters.small_count" "" in Surface Integer, Frame, number(240.0), [0.0, 5000.0],
        "With the law classes: craters of 0.6 to 3 m radius, on the same square.";
    CratersDensity "craters.density" "" in Surface Number, Frame, number(1.0), [0.0, 1.6],
        "Number of craters relative to equilibrium, 0.0794 D^-2 of more than D metres a square metre (Trask 1966).";
    CratersFreshShare "craters.fresh_share" "" in Surface Number, Frame, number(0.03), [0.0, 1.0],
        "Share of craters that are fresh: deep, with a sharp rim and rocks around.";
    RocksCount "rocks.count" "" in Nominal Integer, Frame, UniformInt { low: 75.0, high: 114.0 }, [0.0, 5000.0],
        "Number of rocks.";
    RocksNearCount "rocks.near_count" "" in Nominal Integer, Frame, number(12.0), [0.0, 200.0],
        "The first so many rocks are near ones; if there are fewer rocks, all are.";
    RocksScaleM "rocks.scale_m" "m" in Nominal Number, Element("far rock"), uniform(0.3, 1.3), [0.02, 20.0],
        "Base radius of a far rock.";
    RocksNearScaleM "rocks.near_scale_m" "m" in Nominal Number, Element("near rock"), uniform(1.2, 3.0), [0.02, 20.0],
        "Base radius of a near rock.";
    RocksNearYM "rocks.near_y_m" "m" in Nominal Number, Element("near rock"), uniform(-78.0, -48.0), [-2000.0, 2000.0],
        "Place of a near rock along the camera's nominal line of sight; the camera stands at -90.";
    RocksLargeShare "rocks.large_share" "" in Nominal Number, Frame, number(0.15), [0.0, 1.0],
        "Share of the far rocks that are made larger by rocks.large_factor.";
    RocksLargeFactor "rocks.large_factor" "" in Nominal Number, Element("large far rock"), uniform(2.0, 3.3), [1.0, 10.0],
        "How much larger such a rock is.";
    RocksEmbedding "rocks.embedding" "" in Nominal Number, Frame, number(0.30), [0.02, 0.95],
        "Fraction of a rock's height that is under the ground.";
    RocksAlbedo "rocks.albedo" "" in Nominal Number, Element("rock material"), Power { low: 0.058, high: 0.130, exponent: 1.6 }, [0.02, 0.55],
        "Base grey of a rock material, of which a scene has twelve.";
    RocksRoughness "rocks.roughness" "" Number, Element("rock material"), uniform(0.85, 0.97) => number(0.9), [0.0, 1.0],
        "Roughness of a rock material's diffuse lobe.";
    RocksDisplacement "rocks.displacement" "" Number, Frame, number(0.34) => number(0.30), [0.0, 0.8],
        "Amplitude of the displacement that shapes the rocks, relative to their radius.";
    RocksHeroScaleM "rocks.hero_scale_m" "m" in Nominal Number, Frame, number(0.0), [0.0, 20.0],
        "Base radius of one boulder that takes the place of the first near rock; 0 for none.";
    RocksHeroXM "rocks.hero_x_m" "m" in Nominal Number, Frame, number(0.0), [-2000.0, 2000.0],
        "Where that boulder lies, to the right.";
    RocksHeroYM "rocks.hero_y_m" "m" in Nominal Number, Frame, number(-76.0), [-2000.0, 2000.0],
        "Where that boulder lies, ahead.";
    RocksLaw "rocks.law" "" in Surface Text(&["lunar", "bands"]), Frame, word("lunar"), [0.0, 0.0],
        "How many rocks there are: by the Moon's law of sizes and around fresh craters, or four counted bands.";
    RocksPebbleCount "rocks.pebble_count" "" in Surface Integer, Frame, number(1300.0), [0.0, 20_000.0],
        "With the law bands: rocks of 0.04 to 0.18 m radius, within 60 m ahead of the camera's nominal place (0, -90).";
    RocksSmallCount "rocks.small_count" "" in Surface Integer, Frame, number(420.0), [0.0, 5000.0],
        "With the law bands: rocks of 0.18 to 0.50 m radius, within 120 m ahead of that place.";
    RocksMidCount "rocks.mid_count" "" in Surface Integer, Frame, number(95.0), [0.0, 2000.0],
        "With the law bands: rocks of 0.50 to 1.40 m radius, within 200 m ahead of that place.";
    RocksLargeCount "rocks.large_count" "" in Surface Integer, Frame, number(12.0), [0.0, 500.0],
        "With the law bands: rocks of 1.6 to 3.4 m radius, within 320 m ahead of that place.";
    RocksCoverage "rocks.coverage" "" in Surface Number, Frame, number(0.008), [0.0, 0.1],
        "Share k of the ground under rocks, with F(>D) = k exp(-(0.5648 + 0.01285 / k) D) (Li and Wu 2018).";
    RocksExposed "rocks.exposed" "" in Surface Number, Element("rock"), uniform(0.35, 0.95), [0.05, 1.0],
        "Fraction of a rock's height that stands out of the ground.";
    RocksAlbedoRatio "rocks.albedo_ratio" "" in Surface Number, Frame, number(1.35), [0.3, 4.0],
        "Median of the rocks' albedo over the soil's, one draw a rock, log-normal within 0.7 to 2.5.";
    RocksAlbedoSpread "rocks.albedo_spread" "" in Surface Number, Frame, number(0.3), [0.0, 1.0],
        "Standard deviation of the logarithm of that ratio.";
    RocksDust "rocks.dust" "" in Surface Number, Element("rock"), uniform(0.1, 0.6), [0.0, 1.0],
        "Share of a rock's upward faces that soil lies on.";
    PhotometryLaw "photometry.law" "" Text(&["lambert", "oren_nayar", "lommel_seeliger", "hapke"]), Frame, word("oren_nayar") => word("hapke"), [0.0, 0.0],
        "How ground and rocks reflect; the albedo is that of the law at normal incidence and zero phase.";
    HapkeW "hapke.w" "" Number, Frame, number(0.32357), [0.05, 0.95],
        "Single-scattering albedo of the grains: how much light is scattered more than once.";
    HapkeB "hapke.b" "" Number, Frame, number(0.23955), [0.0, 0.9],
        "Width of the lobes of the grains' phase function (0 is even).";
    HapkeC "hapke.c" "" Number, Frame, number(0.30452), [-1.0, 1.0],
        "Weight of the backward lobe, 1 for all of it, -1 for all of the forward one (Hapke 2012).";
    HapkeBS0 "hapke.b_s0" "" Number, Frame, number(1.80238), [0.0, 4.0],
        "Height of the opposition surge on the ground.";
    HapkeRockBS0 "hapke.rock_b_s0" "" Number, Frame, number(0.85), [0.0, 4.0],
        "Height of the opposition surge on rocks.";
    HapkeHS "hapke.h_s" "" Number, Frame, number(0.07145), [0.005, 1.0],
        "Width of the opposition surge: the tangent of half the phase angle at which it has halved.";
    HapkeThetaBarDeg "hapke.theta_bar_deg" "deg" Number, Frame, number(23.657), [0.0, 40.0],
        "Mean slope of the roughness that no pixel shows (Sato et al. 2014 for the whole Moon).";
    LabelMinPixels "label.min_pixels" "" Number, Frame, number(0.0), [0.0, 100_000.0],
        "Rocks that would cover fewer pixels, as discs of their diameter with nothing before them, count as regolith.";
    LabelMinDiameterM "label.min_diameter_m" "m" Number, Frame, number(0.0), [0.0, 10.0],
        "Rocks with a smaller diameter count as regolith.";
    LabelCraterMinDiameterM "label.crater_min_diameter_m" "m" Number, Frame, number(0.5), [0.1, 100.0],
        "Smaller craters are not marked as such.";
    LabelCraterMinDepth "label.crater_min_depth" "" Number, Frame, number(0.04), [0.0, 0.5],
        "Craters whose depth is a smaller part of their diameter are worn so much that they are not marked.";
    CameraXM "camera.x_m" "m" Number, Frame, number(0.0), [-2000.0, 2000.0],
        "Where the camera stands, to the right.";
    CameraYM "camera.y_m" "m" Number, Frame, number(-90.0), [-2000.0, 2000.0],
        "Where the camera stands, ahead.";
    CameraHeightM "camera.height_m" "m" Number, Frame, number(2.0) => number(2.1), [0.2, 200.0],
        "Height of the eye above the ground under it.";
    CameraPitchDeg "camera.pitch_deg" "deg" Number, Frame, number(-0.8952) => number(-7.0), [-89.0, 89.0],
        "How far the camera looks up; negative looks down.";
    CameraYawDeg "camera.yaw_deg" "deg" Number, Frame, number(0.0), [-360.0, 360.0],
        "How far the camera is turned from +Y towards +X.";
    CameraRollDeg "camera.roll_deg" "deg" Number, Frame, number(0.0), [-180.0, 180.0],
        "How far the camera is turned clockwise about its line of sight.";
    CameraFovDeg "camera.fov_deg" "deg" Number, Frame, number(61.9275) => number(60.0), [5.0, 150.0],
        "Horizontal field of view; the default is a 20 mm lens before a sensor 24 mm wide.";
    CameraK1 "camera.k1" "" Number, Frame, number(0.0), [-0.6, 0.6],
        "Radial distortion of the lens (Brown and Conrady, as in OpenCV): negative for barrels.";
    CameraK2 "camera.k2" "" Number, Frame, number(0.0), [-0.6, 0.6],
        "Radial distortion, of the fourth power.";
    CameraK3 "camera.k3" "" Number, Frame, number(0.0), [-0.6, 0.6],
        "Radial distortion, of the sixth power.";
    CameraP1 "camera.p1" "" Number, Frame, number(0.0), [-0.1, 0.1],
        "Tangential distortion.";
    CameraP2 "camera.p2" "" Number, Frame, number(0.0), [-0.1, 0.1],
        "Tangential distortion.";
    CameraExposureEv "camera.exposure_ev" "EV" Number, Frame, number(0.0) => number(1.9), [-10.0, 10.0],
        "Exposure relative to the reference frame's, in stops.";
    SensorKind "sensor.kind" "" Text(&["off", "mono", "bayer"]), Frame, word("off"), [0.0, 0.0],
        "Whether the picture is that of a sensor: without colour, or with a Bayer mosaic.";
    SensorGroundLevel "sensor.ground_level" "" Number, Frame, number(0.0), [0.0, 0.95],
        "Encoded level that the median of the sunlit ground is put at; 0 for the exposure of camera.exposure_ev.";
    SensorGlare "sensor.glare" "" Number, Frame, number(0.01), [0.0, 0.3],
        "Veiling glare: light spread over the whole picture, as a part of its mean (0.005 to 0.03).";
    SensorVignetting "sensor.vignetting" "" Number, Frame, number(0.5), [0.0, 1.0],
        "Share of the natural fall of light to the corners, cos^4 of the angle.";
    SensorPsfPx "sensor.psf_px" "px" Number, Frame, number(0.47), [0.0, 5.0],
        "Deviation of the picture of a point, pixel included; 0.47 gives a contrast of 0.33 at the finest pattern, as PCAM's.";
    SensorFullWellE "sensor.full_well_e" "e" Number, Frame, number(21_800.0), [100.0, 1_000_000.0],
        "Electrons that a pixel holds before it clips (KAI-2020: 21 800).";
    SensorReadNoiseE "sensor.read_noise_e" "e" Number, Frame, number(21.0), [0.0, 1000.0],
        "Deviation that reading adds (KAI-2020: 21 to 22).";
    SensorDarkE "sensor.dark_e" "e" Number, Frame, number(5.0), [0.0, 10_000.0],
        "Electrons of an exposure that come without light.";
    SensorDsnuE "sensor.dsnu_e" "e" Number, Frame, number(3.0), [0.0, 1000.0],
        "Deviation of those from pixel to pixel, the same in every frame.";
    SensorPrnu "sensor.prnu" "" Number, Frame, number(0.01), [0.0, 0.2],
        "Relative deviation of the pixels' sensitivity, the same in every frame.";
    SensorBlackLevel "sensor.black_level" "" Number, Frame, number(0.003), [0.0, 0.2],
        "Part of the full scale that becomes black, as published pictures are stretched: skies come to 0 to 2 of 255.";
    SensorBits "sensor.bits" "" Integer, Frame, number(11.0), [4.0, 16.0],
        "Bits of a reading.";
    SkyStarCount "sky.star_count" "" Integer, Frame, number(220.0), [0.0, 20_000.0],
        "Number of stars.";
    SkyStarGain "sky.star_gain" "" Number, Frame, number(1.0) => number(1e-5), [0.0, 100.0],
        "Radiance of the stars relative to the nominal stage's; at 1e-5 one is as faint as a bright star is by daylight.";
    SkyGlow "sky.glow" "" Number, Frame, number(1.0) => number(0.0), [0.0, 100.0],
        "Radiance of the dome relative to the nominal stage's; the Moon's sky has none.";
    SkyEarthshine "sky.earthshine" "" Number, Frame, number(0.0), [0.0, 0.1],
        "Light of the Earth on level ground over the sun's on a surface that faces it, even from all sides; a full Earth has 1.1e-4.";
    SkyDomeRadiusM "sky.dome_radius_m" "m" Number, Frame, number(600.0) => number(2000.0), [60.0, 5000.0],
        "Radius of the sky's dome around the camera.";
}

impl Knob {
    /// Its row.
    #[must_use]
    pub fn info(self) -> &'static KnobInfo {
        &KNOBS[self as usize]
    }

    /// Its dotted name, which is also that of its random stream.
    #[must_use]
    pub fn name(self) -> &'static str {
        self.info().name
    }
}

impl KnobInfo {
    /// Whether a stage has it.
    #[must_use]
    pub fn is_of(&self, stage: Stage) -> bool {
        self.stage.is_none_or(|own| own == stage)
    }

    /// Its default on a stage.
    #[must_use]
    pub fn default_on(&self, stage: Stage) -> &Distribution {
        self.surface_default.as_ref().filter(|_| stage == Stage::Surface).unwrap_or(&self.default)
    }

    /// The allowed values in words, with the unit.
    #[must_use]
    pub fn allowed(&self) -> String {
        let [low, high] = self.range;
        let unit = if self.unit.is_empty() { String::new() } else { format!(" {}", self.unit) };
        match self.kind {
            Number => format!("{low} to {high}{unit}"),
            Integer => format!("whole numbers, {low} to {high}{unit}"),
            Rgb => format!("[r, g, b], each {low} to {high}"),
            Text(words) => words.join(", "),
        }
    }

    /// Checks that whatever the distribution can give is right for this knob.
    fn check(&self, distribution: &Distribution, origin: &str) -> Result<()> {
        let wrong_type = |expected: &str| Error::KnobType {
            name: self.name.to_owned(),
            value: distribution.to_string(),
            origin: origin.to_owned(),
            expected: match self.kind {
                Text(_) => expected.to_owned(),
                _ => format!("{expected} (allowed: {})", self.allowed()),
            },
        };
        let out_of_range = || Error::KnobOutOfRange {
            name: self.name.to_owned(),
            value: distribution.to_string(),
            origin: origin.to_owned(),
            allowed: match (self.kind, distribution) {
                (Text(words), Fixed(Value::Text(word))) => nearest(word, words.iter().copied()).map_or_else(
                    || self.allowed(),
                    |near| format!("{} (did you mean `{near}`?)", self.allowed()),
                ),
                _ => self.allowed(),
            },
        };
        let within = |value: &f64| (self.range[0]..=self.range[1]).contains(value);
        let whole_draws = matches!(distribution, Fixed(_) | UniformInt { .. } | Distribution::Choice { .. });
        for bound in distribution.bounds() {
            let allowed = match (self.kind, bound) {
                (Number, Value::Number(value)) => within(&value),
                (Integer, Value::Number(value)) if whole_draws && value.fract() == 0.0 => within(&value),
                (Rgb, Value::Rgb(rgb)) => rgb.iter().all(within),
                (Text(words), Value::Text(word)) => words.contains(&&*word),
                (Number, _) => return Err(wrong_type("a number, or a distribution of numbers")),
                (Integer, _) => {
                    return Err(wrong_type("a whole number, {uniform_int=[a,b]}, or a choice of them"));
                }
                (Rgb, _) => return Err(wrong_type("a colour [r, g, b]")),
                (Text(words), _) => return Err(wrong_type(&format!("one of {}", words.join(", ")))),
            };
            if !allowed {
                return Err(out_of_range());
            }
        }
        Ok(())
    }
}

/// The values of one frame, checked.
///
/// Knobs that are drawn once a frame have their value; those drawn for each element keep their distribution.
#[derive(Clone, Debug, PartialEq)]
pub struct Params {
    settings: Vec<Distribution>,
}

impl Params {
    /// The defaults, drawn for a seed.
    ///
    /// # Panics
    /// Never: a test holds the table's defaults against their rules.
    #[must_use]
    pub fn draw_default(seed: u64) -> Self {
        sampler::Config::new().draw(seed).expect("the defaults keep their own rules")
    }

    fn value(&self, knob: Knob) -> &Value {
        match &self.settings[knob as usize] {
            Fixed(value) => value,
            _ => panic!("{} is drawn for each element: use `sample`", knob.name()),
        }
    }

    /// The number of a knob that is drawn once a frame.
    ///
    /// # Panics
    /// If the table says that it is something else.
    #[must_use]
    pub fn number(&self, knob: Knob) -> f64 {
        match self.value(knob) {
            Value::Number(value) => *value,
            _ => panic!("{} is no number", knob.name()),
        }
    }

    /// The whole number of a knob that is drawn once a frame.
    ///
    /// # Panics
    /// If the table says that it is something else.
    #[must_use]
    pub fn count(&self, knob: Knob) -> u32 {
        self.number(knob) as u32
    }

    /// The colour of a knob.
    ///
    /// # Panics
    /// If the table says that it is something else.
    #[must_use]
    pub fn rgb(&self, knob: Knob) -> [f64; 3] {
        match self.value(knob) {
            Value::Rgb(rgb) => *rgb,
            _ => panic!("{} is no colour", knob.name()),
        }
    }

    /// The word of a knob.
    ///
    /// # Panics
    /// If the table says that it is something else.
    #[must_use]
    pub fn text(&self, knob: Knob) -> &str {
        match self.value(knob) {
            Value::Text(text) => text,
            _ => panic!("{} is no word", knob.name()),
        }
    }

    /// Draws the number of a knob for one element.
    ///
    /// # Panics
    /// If the table says that it is something else.
    #[must_use]
    pub fn sample(&self, knob: Knob, stream: &mut Stream) -> f64 {
        match self.settings[knob as usize].sample(stream) {
            Value::Number(value) => value,
            _ => panic!("{} is no number", knob.name()),
        }
    }

    /// The stage.
    ///
    /// # Panics
    /// Never: the table allows no other word.
    #[must_use]
    pub fn stage(&self) -> Stage {
        Stage::from_name(self.text(Knob::StageName)).expect("a stage that there is")
    }

    /// Every knob of the stage as used, under its dotted name; those drawn for each element as what they are drawn from.
    #[must_use]
    pub fn to_json(&self) -> Map<String, Json> {
        KNOBS
            .iter()
            .zip(&self.settings)
            .filter(|(info, _)| info.is_of(self.stage()))
            .map(|(info, setting)| (info.name.to_owned(), setting.to_json(info.kind == Integer)))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_keeps_its_own_rules() {
        for (place, info) in KNOBS.iter().enumerate() {
            assert_eq!(Knob::ALL[place] as usize, place);
            for default in [&info.default].into_iter().chain(&info.surface_default) {
                info.check(default, "default").unwrap_or_else(|error| panic!("{error}"));
            }
            assert!(info.doc.ends_with('.') && info.doc.len() > 10, "{}", info.name);
            let suffix = match info.unit {
                "" => continue,
                "m" => "_m",
                "deg" => "_deg",
                "EV" => "_ev",
                "mrad" => "_mrad",
                "px" => "_px",
                "e" => "_e",
                other => panic!("{}: a new unit {other}", info.name),
            };
            assert!(info.name.ends_with(suffix), "{} is in {}", info.name, info.unit);
        }
        for (i, a) in KNOBS.iter().enumerate() {
            assert_eq!(a.name.matches('.').count(), 1, "{}", a.name);
            assert!(KNOBS[i + 1..].iter().all(|b| a.name != b.name), "{} stands twice", a.name);
        }
        let mut sections: Vec<&str> = KNOBS.iter().filter_map(|info| info.name.split('.').next()).collect();
        sections.dedup();
        let mut once = sections.clone();
        once.sort_unstable();
        once.dedup();
        assert_eq!(sections.len(), once.len(), "the knobs of a section stand together");
    }

    #[test]
    fn every_knob_can_be_asked_as_its_kind() {
        let mut stream = crate::random::Streams::new(1).stream("test", 0);
        for (stage, name) in Stage::ALL {
            let mut config = sampler::Config::new();
            config.set_stage(name).expect("a stage");
            let params = config.draw(1).expect("drawn");
            assert_eq!(params.stage(), stage);
            for (knob, info) in Knob::ALL.into_iter().zip(&KNOBS) {
                match (info.kind, info.scope) {
                    (Number | Integer, Element(_)) => assert!(params.sample(knob, &mut stream).is_finite()),
                    (Number, Frame) => assert!(params.number(knob).is_finite()),
                    (Integer, Frame) => assert_eq!(f64::from(params.count(knob)), params.number(knob)),
                    (Rgb, _) => assert_eq!(params.rgb(knob).len(), 3),
                    (Text(words), _) => assert!(words.contains(&params.text(knob))),
                }
            }
            let json = params.to_json();
            assert_eq!(json.len(), KNOBS.iter().filter(|info| info.is_of(stage)).count());
        }
        let json = Params::draw_default(1).to_json();
        assert_eq!(json["rocks.scale_m"].to_string(), r#"{"uniform":[0.3,1.3]}"#);
        assert!(json["rocks.count"].is_u64() && json["sun.elevation_deg"] == 17.0);
    }
}
