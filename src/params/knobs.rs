//! The table of knobs.
//!
//! To add a knob: a row here, and the line of code that uses it.

use super::distribution::Distribution::{self, Fixed, Power, Uniform, UniformInt};
use super::distribution::Value;
use super::knob_info::Kind::{Integer, Number, Rgb, Text};
use super::knob_info::Scope::{Element, Frame};
use super::knob_info::{KnobInfo, Stage};

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
        /// Every knob; the discriminant is its index in [`KNOBS`].
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
        "Stage to build: the nominal reference stage or the realistic surface.";
    SunElevationDeg "sun.elevation_deg" "deg" Number, Frame, number(17.0) => number(13.0), [0.5, 90.0],
        "Elevation of the sun above the horizontal plane.";
    SunAzimuthDeg "sun.azimuth_deg" "deg" Number, Frame, number(120.0) => number(135.0), [0.0, 360.0],
        "Azimuth of the sun, clockwise from +Y (the camera's nominal viewing direction) towards +X; at 0 the sun is in front of the camera.";
    SunRelativeAzimuthDeg "sun.relative_azimuth_deg" "deg" Number, Frame, number(120.0) => number(135.0), [-360.0, 360.0],
        "Azimuth of the sun, clockwise from the camera's heading: 0 is in front of the camera, 180 behind it. Instead of sun.azimuth_deg: of the two, the one that was set last counts, and the other is computed.";
    SunIntensity "sun.intensity" "" Number, Frame, number(14_000.0) => number(3500.0), [0.0, 200_000.0],
        "Intensity of the sun on a relative scale; 14000 in the reference frame.";
    SunAngularDiameterDeg "sun.angular_diameter_deg" "deg" Number, Frame, number(0.53), [0.0, 5.0],
        "Angular diameter of the sun's disc; it sets how fast penumbrae widen.";
    SunColor "sun.color" "" Rgb, Frame, Fixed(Value::Rgb([1.0, 0.97, 0.92])) => Fixed(Value::Rgb([1.0, 1.0, 1.0])), [0.0, 4.0],
        "Colour of the sun's light, linear RGB.";
    TerrainAmplitudeM "terrain.amplitude_m" "m" in Nominal Number, Frame, number(3.2), [0.0, 50.0],
        "Amplitude of the relief; its standard deviation is about a quarter of this.";
    TerrainSizeM "terrain.size_m" "m" Number, Frame, number(920.0) => number(2400.0), [100.0, 4000.0],
        "Side of the square of ground, centred on the origin; on the surface stage the diameter of the disc of ground around the camera.";
    TerrainCells "terrain.cells" "" in Nominal Integer, Frame, number(300.0), [10.0, 1000.0],
        "Cells along each side of the ground's heightfield, two triangles per cell.";
    TerrainCellMrad "terrain.cell_mrad" "mrad" in Surface Number, Frame, number(12.0), [2.0, 50.0],
        "Angle that one cell of the ground mesh spans as seen from the camera, less below a field of view of 45 degrees; finer detail is added in shading.";
    ReliefHillsM "relief.hills_m" "m" in Surface Number, Frame, number(9.0), [0.0, 60.0],
        "Amplitude of hills with wavelengths of 250 m and below; their standard deviation is about a sixth of this.";
    ReliefUndulationM "relief.undulation_m" "m" in Surface Number, Frame, number(2.4), [0.0, 20.0],
        "Amplitude of undulations with wavelengths of 50 m and below; their standard deviation is about a sixth of this.";
    ReliefFarHillsM "relief.far_hills_m" "m" in Surface Number, Frame, number(0.0), [0.0, 400.0],
        "Height of the peaks of hills on the horizon, which rise beyond a third of the ground's radius from the camera; 0 for a level horizon.";
    ReliefSlopeDeg "relief.slope_deg" "deg" in Surface Number, Frame, number(10.0), [0.0, 25.0],
        "Median slope of the fine relief over a 7 mm baseline (Guo et al. 2021: 10 at the Chang'e-4 site).";
    ReliefHurst "relief.hurst" "" in Surface Number, Frame, number(0.75), [0.4, 1.0],
        "Hurst exponent of the fine relief; at 1 it is smooth at small scales (Guo et al. 2021: 0.6 to 0.85).";
    ReliefClods "relief.clods" "" in Surface Number, Frame, number(0.5), [0.0, 1.0],
        "Fraction of clods among pits and clods up to 8 cm across.";
    WallHeightM "wall.height_m" "m" in Surface Number, Frame, number(0.0), [0.0, 400.0],
        "Height of the crest of a large old crater above its floor, on which the camera stands; 0 for no such crater.";
    WallDistanceM "wall.distance_m" "m" in Surface Number, Frame, number(600.0), [50.0, 2000.0],
        "Distance from the camera to the crest of that crater's wall, in the direction of wall.relative_azimuth_deg. Up to twice wall.radius_m the camera stands inside the crater; beyond, it sees the wall's outer slope.";
    WallRadiusM "wall.radius_m" "m" in Surface Number, Frame, number(700.0), [100.0, 2000.0],
        "Radius of that crater, from its centre to the crest of its rim.";
    WallSlopeDeg "wall.slope_deg" "deg" in Surface Number, Frame, number(22.0), [5.0, 35.0],
        "Slope of the straight part of its inner wall, which is less steep at its foot and at its crest.";
    WallRelativeAzimuthDeg "wall.relative_azimuth_deg" "deg" in Surface Number, Frame, number(0.0), [-360.0, 360.0],
        "Direction from the camera in which the crest has that distance, clockwise from the camera's heading.";
    WallRocks "wall.rocks" "" in Surface Number, Frame, number(6.0), [1.0, 40.0],
        "Rocks on the wall, where there are most, relative to the coverage of the plain, but at most on 12 % of the wall; with rocks.law = \"lunar\".";
    GrainsDensity "grains.density" "" in Surface Number, Frame, number(1.0), [0.0, 2.5],
        "Number of grains of 1 mm to 3 cm relative to that counted by Surveyor III: 90 larger than 1 cm per square metre, N(>D) proportional to D^-2.4. Two fifths are fragments of rock, more where rocks.coverage asks for more; the others are clods of soil.";
    GrainsAlbedoSpread "grains.albedo_spread" "" in Surface Number, Frame, number(0.6), [0.0, 1.0],
        "Standard deviation of the logarithm of the albedo of fragments of rock of 1 mm to 3 cm around rocks.albedo_ratio; that of clods is a fifth of it.";
    RegolithMottling "regolith.mottling" "" in Surface Number, Frame, number(0.05), [0.0, 0.3],
        "Standard deviation of the logarithm of the soil's albedo, from millimetres to decimetres.";
    RegolithRays "regolith.rays" "" in Surface Number, Frame, number(0.0), [0.0, 0.6],
        "Logarithm of the albedo of the brightest halo and rays of fresh craters of 10 m and more over that of the soil between; 0 for none.";
    RegolithAlbedo "regolith.albedo" "" Number, Frame, number(0.205) => number(0.12), [0.0, 1.0],
        "Mean diffuse reflectance of the ground.";
    RegolithRoughness "regolith.roughness" "" Number, Frame, number(0.96), [0.0, 1.0],
        "Roughness of the ground's diffuse lobe; 0 is Lambertian.";
    RegolithRedOverGreen "regolith.red_over_green" "" in Surface Number, Frame, number(1.05), [0.5, 2.0],
        "Soil colour: linear red over green; 1.00 to 1.12 for lunar soil.";
    RegolithBlueOverGreen "regolith.blue_over_green" "" in Surface Number, Frame, number(0.88), [0.3, 2.0],
        "Soil colour: linear blue over green; 0.72 to 0.95 for lunar soil.";
    CratersCount "craters.count" "" in Nominal Integer, Frame, UniformInt { low: 6.0, high: 10.0 }, [0.0, 500.0],
        "Number of craters.";
    CratersRadiusM "craters.radius_m" "m" in Nominal Number, Element("crater"), uniform(10.0, 38.0), [0.5, 400.0],
        "Radius of a crater, from its centre to the rim crest.";
    CratersDepthM "craters.depth_m" "m" in Nominal Number, Element("crater"), uniform(1.5, 5.5), [0.0, 60.0],
        "Depth of a crater's bowl below the surrounding ground.";
    CratersRimRatio "craters.rim_ratio" "" in Nominal Number, Element("crater"), uniform(0.18, 0.35), [0.0, 1.0],
        "Rim height as a fraction of the crater's depth.";
    CratersLaw "craters.law" "" in Surface Text(&["equilibrium", "classes"]), Frame, word("equilibrium"), [0.0, 0.0],
        "How craters larger than 1.25 m are populated: equilibrium of impacts and erosion, or three classes with fixed counts.";
    CratersBigCount "craters.big_count" "" in Surface Integer, Frame, number(7.0), [0.0, 100.0],
        "With craters.law = \"classes\": number of craters of 14 to 40 m radius in a 766 m square around the origin.";
    CratersMediumCount "craters.medium_count" "" in Surface Integer, Frame, number(42.0), [0.0, 1000.0],
        "With craters.law = \"classes\": number of craters of 3 to 12 m radius in the same square.";
    CratersSmallCount "craters.small_count" "" in Surface Integer, Frame, number(240.0), [0.0, 5000.0],
        "With craters.law = \"classes\": number of craters of 0.6 to 3 m radius in the same square.";
    CratersDensity "craters.density" "" in Surface Number, Frame, number(1.0), [0.0, 1.6],
        "Crater density relative to equilibrium, N(>D) = 0.0794 D^-2 per square metre (Trask 1966).";
    CratersFreshShare "craters.fresh_share" "" in Surface Number, Frame, number(0.03), [0.0, 1.0],
        "Fraction of craters that are fresh: deep, with a sharp rim and ejected rocks.";
    RocksCount "rocks.count" "" in Nominal Integer, Frame, UniformInt { low: 75.0, high: 114.0 }, [0.0, 5000.0],
        "Number of rocks.";
    RocksNearCount "rocks.near_count" "" in Nominal Integer, Frame, number(12.0), [0.0, 200.0],
        "Number of rocks placed near the camera; they are the first ones in rocks.count.";
    RocksScaleM "rocks.scale_m" "m" in Nominal Number, Element("far rock"), uniform(0.3, 1.3), [0.02, 20.0],
        "Base radius of a far rock.";
    RocksNearScaleM "rocks.near_scale_m" "m" in Nominal Number, Element("near rock"), uniform(1.2, 3.0), [0.02, 20.0],
        "Base radius of a near rock.";
    RocksNearYM "rocks.near_y_m" "m" in Nominal Number, Element("near rock"), uniform(-78.0, -48.0), [-2000.0, 2000.0],
        "Y coordinate of a near rock; the camera's default is -90.";
    RocksLargeShare "rocks.large_share" "" in Nominal Number, Frame, number(0.15), [0.0, 1.0],
        "Fraction of far rocks that are enlarged by rocks.large_factor.";
    RocksLargeFactor "rocks.large_factor" "" in Nominal Number, Element("large far rock"), uniform(2.0, 3.3), [1.0, 10.0],
        "Scale factor of an enlarged far rock.";
    RocksEmbedding "rocks.embedding" "" in Nominal Number, Frame, number(0.30), [0.02, 0.95],
        "Fraction of a rock's height that is buried.";
    RocksAlbedo "rocks.albedo" "" in Nominal Number, Element("rock material"), Power { low: 0.058, high: 0.130, exponent: 1.6 }, [0.02, 0.55],
        "Base grey of a rock material; a scene has twelve materials.";
    RocksRoughness "rocks.roughness" "" Number, Element("rock material"), uniform(0.85, 0.97) => number(0.9), [0.0, 1.0],
        "Roughness of a rock material's diffuse lobe.";
    RocksDisplacement "rocks.displacement" "" Number, Frame, number(0.34) => number(0.30), [0.0, 0.8],
        "Amplitude of the displacement that shapes the rocks, relative to their radius.";
    RocksHeroScaleM "rocks.hero_scale_m" "m" in Nominal Number, Frame, number(0.0), [0.0, 20.0],
        "Base radius of a single large boulder that replaces the first near rock; 0 for none.";
    RocksHeroXM "rocks.hero_x_m" "m" in Nominal Number, Frame, number(0.0), [-2000.0, 2000.0],
        "X coordinate of that boulder.";
    RocksHeroYM "rocks.hero_y_m" "m" in Nominal Number, Frame, number(-76.0), [-2000.0, 2000.0],
        "Y coordinate of that boulder.";
    RocksLaw "rocks.law" "" in Surface Text(&["lunar", "bands"]), Frame, word("lunar"), [0.0, 0.0],
        "How rocks are populated: the lunar size-frequency distribution with clusters at fresh craters, or four size bands with fixed counts.";
    RocksPebbleCount "rocks.pebble_count" "" in Surface Integer, Frame, number(1300.0), [0.0, 20_000.0],
        "With rocks.law = \"bands\": number of rocks of 0.04 to 0.18 m radius within 60 m ahead of the default camera position (0, -90).";
    RocksSmallCount "rocks.small_count" "" in Surface Integer, Frame, number(420.0), [0.0, 5000.0],
        "With rocks.law = \"bands\": number of rocks of 0.18 to 0.50 m radius within 120 m ahead of that position.";
    RocksMidCount "rocks.mid_count" "" in Surface Integer, Frame, number(95.0), [0.0, 2000.0],
        "With rocks.law = \"bands\": number of rocks of 0.50 to 1.40 m radius within 200 m ahead of that position.";
    RocksLargeCount "rocks.large_count" "" in Surface Integer, Frame, number(12.0), [0.0, 500.0],
        "With rocks.law = \"bands\": number of rocks of 1.6 to 3.4 m radius within 320 m ahead of that position.";
    RocksCoverage "rocks.coverage" "" in Surface Number, Frame, number(0.008), [0.0, 0.1],
        "Fraction k of the ground covered by rocks, F(>D) = k exp(-(0.5648 + 0.01285 / k) D) (Li and Wu 2018).";
    RocksExposed "rocks.exposed" "" in Surface Number, Element("rock"), uniform(0.35, 0.95), [0.05, 1.0],
        "Height of a rock above the ground over its own, to 0.75 diameters; it is flattened, at most by half, or stretched.";
    RocksAlbedoRatio "rocks.albedo_ratio" "" in Surface Number, Frame, number(1.35), [0.3, 4.0],
        "Median ratio of rock albedo to soil albedo; drawn per rock, log-normal, clipped to 0.7 to 2.5, or to the median where that lies outside; no albedo is above 1.";
    RocksAlbedoSpread "rocks.albedo_spread" "" in Surface Number, Frame, number(0.3), [0.0, 1.0],
        "Standard deviation of the logarithm of that ratio.";
    RocksDust "rocks.dust" "" in Surface Number, Element("rock"), uniform(0.1, 0.6), [0.0, 1.0],
        "Fraction of a rock's upward-facing surface covered by soil.";
    PhotometryLaw "photometry.law" "" Text(&["lambert", "oren_nayar", "lommel_seeliger", "hapke"]), Frame, word("oren_nayar") => word("hapke"), [0.0, 0.0],
        "Photometric function of ground and rocks; the albedo is its value at normal incidence and zero phase; with oren_nayar and a roughness of s that value is 1 / (1 + 0.144 s) of it.";
    HapkeW "hapke.w" "" Number, Frame, number(0.32357), [0.05, 0.95],
        "Single-scattering albedo of the grains.";
    HapkeB "hapke.b" "" Number, Frame, number(0.23955), [0.0, 0.9],
        "Asymmetry parameter b of the double Henyey-Greenstein phase function; 0 is isotropic.";
    HapkeC "hapke.c" "" Number, Frame, number(0.30452), [-1.0, 1.0],
        "Weight c of the backward lobe: 1 is backward only, -1 forward only (Hapke 2012).";
    HapkeBS0 "hapke.b_s0" "" Number, Frame, number(1.80238), [0.0, 4.0],
        "Amplitude of the shadow-hiding opposition effect of the ground.";
    HapkeRockBS0 "hapke.rock_b_s0" "" Number, Frame, number(0.85), [0.0, 4.0],
        "Amplitude of the shadow-hiding opposition effect of rocks.";
    HapkeHS "hapke.h_s" "" Number, Frame, number(0.07145), [0.005, 1.0],
        "Angular width of the opposition effect: the tangent of half the phase angle at half amplitude.";
    HapkeThetaBarDeg "hapke.theta_bar_deg" "deg" Number, Frame, number(23.657), [0.0, 40.0],
        "Mean slope angle of unresolved roughness (Sato et al. 2014: mean of the whole Moon).";
    LabelMinPixels "label.min_pixels" "" Number, Frame, number(0.0), [0.0, 100_000.0],
        "Rocks whose unoccluded disc would cover fewer pixels are too small: label.too_small says what becomes of them.";
    LabelMinDiameterM "label.min_diameter_m" "m" Number, Frame, number(0.0), [0.0, 10.0],
        "Rocks with a smaller diameter are too small: label.too_small says what becomes of them.";
    LabelTooSmall "label.too_small" "" Text(&["ignore", "regolith", "rock"]), Frame, word("regolith"), [0.0, 0.0],
        "What rocks become that are too small: ignore (255 in the mask; also rocks of which fewer than label.min_pixels are visible), regolith, or rock.";
    LabelUnseen "label.unseen" "" Text(&["ignore", "regolith", "rock"]), Frame, word("rock"), [0.0, 0.0],
        "What rocks become that nobody can see, because they lie in shadow or differ too little from what surrounds them: ignore (255 in the mask), regolith or rock.";
    LabelUnseenContrast "label.unseen_contrast" "" Number, Frame, number(3.0), [0.0, 100.0],
        "Contrast below which a rock counts as unseen, in standard deviations of a pixel's noise; without a sensor, in steps of the 8-bit image; at 0 no rock does.";
    LabelCraterMinDiameterM "label.crater_min_diameter_m" "m" Number, Frame, number(0.5), [0.1, 100.0],
        "Craters with a smaller diameter are not labelled.";
    LabelCraterMinDepth "label.crater_min_depth" "" Number, Frame, number(0.04), [0.0, 0.5],
        "Craters with a smaller ratio of depth to diameter count as too degraded and are not labelled.";
    RoverKind "rover.kind" "" Text(&["off", "rover"]), Frame, word("off"), [0.0, 0.0],
        "Whether a rover carries the camera and casts its shadow.";
    RoverHeadingDeg "rover.heading_deg" "deg" Number, Frame, number(0.0), [-180.0, 180.0],
        "Heading of the rover relative to that of the camera on its mast, clockwise from above.";
    RoverLengthM "rover.length_m" "m" Number, Frame, number(1.5), [0.3, 5.0],
        "Length of the rover's body; the mast is at its front (Yutu: 1.5).";
    RoverWidthM "rover.width_m" "m" Number, Frame, number(1.0), [0.3, 4.0],
        "Width of the rover's body, without wheels and panels (Yutu: 1.0).";
    RoverDeckM "rover.deck_m" "m" Number, Frame, number(0.8), [0.2, 2.5],
        "Height of the rover's deck above the ground; a camera less than 0.25 m above it is mounted on the front of the body, without a mast.";
    RoverPanelM "rover.panel_m" "m" Number, Frame, number(0.7), [0.0, 3.0],
        "Width of the solar panel on each side of the deck; 0 for none.";
    RoverWheelM "rover.wheel_m" "m" Number, Frame, number(0.3), [0.1, 1.0],
        "Diameter of each of the rover's six wheels; they are half as wide (Yutu: 0.30 and 0.15).";
    RoverVisible "rover.visible" "" Text(&["no", "yes"]), Frame, word("no"), [0.0, 0.0],
        "Whether the camera sees the rover, where it is in view; its pixels have the label 255. It casts its shadow either way.";
    TracksOwn "tracks.own" "" in Surface Text(&["no", "yes"]), Frame, word("no"), [0.0, 0.0],
        "Whether the rover of rover.kind has left tracks behind it as it came.";
    TracksCount "tracks.count" "" in Surface Integer, Frame, number(0.0), [0.0, 8.0],
        "Number of tracks, two ruts each, that rovers with wheels as rover.wheel_m and rover.width_m say have left in the view; label 0.";
    TracksDistanceM "tracks.distance_m" "m" in Surface Number, Element("track"), uniform(1.5, 8.0), [0.0, 100.0],
        "Distance from the camera at which a track crosses the middle half of the view.";
    TracksDirectionDeg "tracks.direction_deg" "deg" in Surface Number, Element("track"), uniform(-90.0, 90.0), [-180.0, 180.0],
        "Direction of a track there, clockwise from the camera's heading.";
    TracksCurvaturePerM "tracks.curvature_per_m" "1/m" in Surface Number, Element("track"), uniform(-0.08, 0.08), [-0.5, 0.5],
        "Curvature of a track, positive where the rover turned left: the inverse of the radius.";
    TracksDepthM "tracks.depth_m" "m" in Surface Number, Element("track"), uniform(0.01, 0.025), [0.0, 0.1],
        "Depth of a rut: lunar soil yields 1 to 2 cm to a light rover, 5 cm and more on loose slopes.";
    TracksGrouserM "tracks.grouser_m" "m" in Surface Number, Frame, number(0.008), [0.0, 0.03],
        "Depth that grousers press below the floor of a rut, at most that of the rut; each wheel has 24 of them.";
    CameraXM "camera.x_m" "m" Number, Frame, number(0.0), [-2000.0, 2000.0],
        "X coordinate of the camera (right).";
    CameraYM "camera.y_m" "m" Number, Frame, number(-90.0), [-2000.0, 2000.0],
        "Y coordinate of the camera (forward).";
    CameraHeightM "camera.height_m" "m" Number, Frame, number(2.0) => number(2.1), [0.2, 200.0],
        "Height of the camera above the ground below it.";
    CameraPitchDeg "camera.pitch_deg" "deg" Number, Frame, number(-0.8952) => number(-7.0), [-89.0, 89.0],
        "Pitch of the camera; negative looks down.";
    CameraYawDeg "camera.yaw_deg" "deg" Number, Frame, number(0.0), [-360.0, 360.0],
        "Yaw of the camera, clockwise from +Y towards +X.";
    CameraRollDeg "camera.roll_deg" "deg" Number, Frame, number(0.0), [-180.0, 180.0],
        "Roll of the camera, clockwise about the optical axis.";
    CameraFovDeg "camera.fov_deg" "deg" Number, Frame, number(61.9275) => number(60.0), [5.0, 150.0],
        "Horizontal field of view; the default corresponds to a 20 mm lens and a 24 mm wide sensor.";
    CameraK1 "camera.k1" "" Number, Frame, number(0.0), [-0.6, 0.6],
        "Radial lens distortion k1 (Brown-Conrady, as in OpenCV); negative for barrel distortion.";
    CameraK2 "camera.k2" "" Number, Frame, number(0.0), [-0.6, 0.6],
        "Radial lens distortion k2, fourth power of the radius.";
    CameraK3 "camera.k3" "" Number, Frame, number(0.0), [-0.6, 0.6],
        "Radial lens distortion k3, sixth power of the radius.";
    CameraP1 "camera.p1" "" Number, Frame, number(0.0), [-0.1, 0.1],
        "Tangential lens distortion p1.";
    CameraP2 "camera.p2" "" Number, Frame, number(0.0), [-0.1, 0.1],
        "Tangential lens distortion p2.";
    CameraExposureEv "camera.exposure_ev" "EV" Number, Frame, number(0.0) => number(1.9), [-10.0, 10.0],
        "Exposure relative to the reference frame, in stops.";
    SensorKind "sensor.kind" "" Text(&["off", "mono", "bayer"]), Frame, word("off"), [0.0, 0.0],
        "Sensor model applied to the image: off, monochrome, or with a Bayer mosaic.";
    SensorGroundLevel "sensor.ground_level" "" Number, Frame, number(0.0), [0.0, 0.95],
        "Automatic exposure: encoded level of the median sunlit ground, less where that would saturate green in more than 1.5 % of the image; 0 uses camera.exposure_ev.";
    SensorGainMaxEv "sensor.gain_max_ev" "EV" Number, Frame, number(4.0), [0.0, 12.0],
        "Longest automatic exposure, in stops above camera.exposure_ev: ground that stays too dark even so is shown dark.";
    SensorWidthPx "sensor.width_px" "px" Integer, Frame, number(0.0), [0.0, 8192.0],
        "Columns of the sensor, which mosaic, noise and point spread are those of; its image is then reduced to --size by area (or enlarged, if it has fewer). 0 for as many as the image has.";
    SensorGlare "sensor.glare" "" Number, Frame, number(0.01), [0.0, 0.3],
        "Veiling glare: the part of the light that the lens scatters evenly over the whole image (0.005 to 0.03 is typical); of a sun in or near the image it is the fraction that bloom and veil have.";
    SensorFlare "sensor.flare" "" Number, Frame, number(0.0), [0.0, 0.1],
        "Reflectance of a surface of the lens, for ghosts of a sun in or near the image: each of six has its square as its share of the light (0.002 to 0.01 is typical of coated lenses, 0.04 of bare glass).";
    SensorVignetting "sensor.vignetting" "" Number, Frame, number(0.5), [0.0, 1.0],
        "Vignetting: fraction of the natural cos^4 falloff that is applied.";
    SensorPsfPx "sensor.psf_px" "px" Number, Frame, number(0.47), [0.0, 5.0],
        "Standard deviation of the point spread function, pixel aperture included; 0.47 gives a contrast of 0.33 at the Nyquist frequency, as PCAM's.";
    SensorFullWellE "sensor.full_well_e" "e" Number, Frame, number(21_800.0), [100.0, 1_000_000.0],
        "Full-well capacity in electrons (KAI-2020: 21 800).";
    SensorReadNoiseE "sensor.read_noise_e" "e" Number, Frame, number(21.0), [0.0, 1000.0],
        "Standard deviation of the read noise in electrons (KAI-2020: 21 to 22).";
    SensorDarkE "sensor.dark_e" "e" Number, Frame, number(5.0), [0.0, 10_000.0],
        "Mean dark signal per exposure in electrons.";
    SensorDsnuE "sensor.dsnu_e" "e" Number, Frame, number(3.0), [0.0, 1000.0],
        "Dark signal non-uniformity: standard deviation in electrons, a fixed pattern.";
    SensorPrnu "sensor.prnu" "" Number, Frame, number(0.01), [0.0, 0.2],
        "Photo response non-uniformity: relative standard deviation, a fixed pattern.";
    SensorBlackLevel "sensor.black_level" "" Number, Frame, number(0.003), [0.0, 0.2],
        "Fraction of full scale that maps to black, at least twice the noise in the dark; published images are stretched so that skies come to 0 to 2 of 255.";
    SensorBits "sensor.bits" "" Integer, Frame, number(11.0), [4.0, 16.0],
        "Bit depth of the analog-to-digital converter.";
    SensorGrain "sensor.grain" "" Number, Frame, number(0.0), [0.0, 0.2],
        "Grain of film: standard deviation of the density of a pixel of the sensor where the density is 1; 0 for none.";
    SensorHalation "sensor.halation" "" Number, Frame, number(0.0), [0.0, 0.2],
        "Halation of film: part of the light that its base reflects into a halo around highlights; 0 for none.";
    SensorStretch "sensor.stretch" "" Number, Frame, number(0.0), [0.0, 0.1],
        "Contrast stretch, as published images have it: fraction of the pixels that becomes black, and as many white; 0 for none (0.005 to 0.02 is usual).";
    SensorJpegQuality "sensor.jpeg_quality" "" Integer, Frame, number(0.0), [0.0, 100.0],
        "Quality of a JPEG compression of the image, whose losses it then has; 0 for none.";
    SkyStarCount "sky.star_count" "" Integer, Frame, number(220.0), [0.0, 20_000.0],
        "Number of stars. They are on the side of the sky towards +Y.";
    SkyStarGain "sky.star_gain" "" Number, Frame, number(1.0) => number(1e-5), [0.0, 100.0],
        "Radiance of the stars relative to the nominal stage; 1e-5 is as faint as a bright star by daylight.";
    SkyGlow "sky.glow" "" Number, Frame, number(1.0) => number(0.0), [0.0, 100.0],
        "Radiance of the sky dome relative to the nominal stage; 0 on the real Moon.";
    SkyEarthshine "sky.earthshine" "" Number, Frame, number(0.0), [0.0, 0.1],
        "Irradiance of earthshine on level ground relative to the sun's at normal incidence, taken as uniform over the sky; 1.1e-4 for a full Earth.";
    SkyDomeRadiusM "sky.dome_radius_m" "m" Number, Frame, number(600.0) => number(2000.0), [60.0, 5000.0],
        "Radius of the sky dome around the camera; ground that is farther away is drawn as sky.";
}

impl KnobInfo {
    /// The knob of this row.
    pub(super) fn knob(&self) -> Knob {
        let index = KNOBS.iter().position(|row| row.name == self.name);
        Knob::ALL[index.expect("a row of the table")]
    }
}

impl Knob {
    /// Its row in the table.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_keeps_its_own_rules() {
        for (index, info) in KNOBS.iter().enumerate() {
            assert_eq!(Knob::ALL[index] as usize, index);
            for default in [&info.default].into_iter().chain(&info.surface_default) {
                info.check(default, "default").unwrap_or_else(|error| panic!("{error}"));
            }
            assert!(info.doc.ends_with('.') && info.doc.len() > 10, "{}", info.name);
            let suffix = match info.unit {
                "" => continue,
                "m" => "_m",
                "1/m" => "_per_m",
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
}
