//! The scene as NumPy arrays (`.npz`): an uncompressed zip archive of `.npy` members, the same bytes every time.
//!
//! Must not know: the sky, whose geometry is not exported here.

use std::io::{Cursor, Write as _};

use super::stage::Stage;
use crate::error::{Error, Result};

/// The arrays: `vertices` float32 N x 3 (metres, world), `normals` float32 N x 3, `triangles` uint32 M x 3,
/// `triangle_class` uint8 M (255 for the rover), `triangle_instance` uint16 M (0 = not a rock), `albedo` float32 per instance x 3 (row 0 is
/// the ground), `world_from_camera` float64 4 x 4 (OpenCV axes), `K` float64 3 x 3, `sun_direction` float32 3.
pub(super) fn encode(stage: &Stage<'_>) -> Result<Vec<u8>> {
    let scene = stage.scene;
    let parts = stage.parts()?;
    let (mut vertices, mut normals, mut triangles) = (Vec::new(), Vec::new(), Vec::new());
    let (mut classes, mut instances) = (Vec::new(), Vec::new());
    for part in &parts {
        let first = vertices.len() as u32;
        vertices.extend(part.vertices.iter().map(|v| (v.position + part.origin).to_array()));
        normals.extend(part.vertices.iter().map(|v| v.normal.to_array()));
        triangles.extend(part.triangles.iter().map(|t| t.map(|v| v + first)));
        classes.resize(triangles.len(), part.class.0);
        instances.resize(triangles.len(), part.instance);
    }
    let mut albedo = vec![scene.regolith.albedo.to_array()];
    albedo.extend(scene.rocks.iter().take(scene.rocks.count()).map(|rock| rock.material.albedo.to_array()));

    let camera = &scene.camera;
    let (k, pose) = (camera.intrinsics(stage.settings.size), camera.world_from_camera());
    let sun = scene.sun.direction.to_array();
    let members: [(&str, &str, &[usize], &[u8]); 9] = [
        ("vertices", "<f4", &[vertices.len(), 3], bytemuck::cast_slice(&vertices)),
        ("normals", "<f4", &[normals.len(), 3], bytemuck::cast_slice(&normals)),
        ("triangles", "<u4", &[triangles.len(), 3], bytemuck::cast_slice(&triangles)),
        ("triangle_class", "|u1", &[classes.len()], &classes),
        ("triangle_instance", "<u2", &[instances.len()], bytemuck::cast_slice(&instances)),
        ("albedo", "<f4", &[albedo.len(), 3], bytemuck::cast_slice(&albedo)),
        ("world_from_camera", "<f8", &[4, 4], bytemuck::cast_slice(&pose)),
        ("K", "<f8", &[3, 3], bytemuck::cast_slice(&k)),
        ("sun_direction", "<f4", &[3], bytemuck::cast_slice(&sun)),
    ];
    archive(&members)
        .map_err(|error| Error::Encode { name: "the .npz file".to_owned(), message: error.to_string() })
}

/// An uncompressed zip archive of arrays: name, dtype, shape, data.
fn archive(members: &[(&str, &str, &[usize], &[u8])]) -> zip::result::ZipResult<Vec<u8>> {
    let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
    for (name, dtype, shape, bytes) in members {
        let options = zip::write::SimpleFileOptions::default()
            .compression_method(zip::CompressionMethod::Stored)
            .last_modified_time(zip::DateTime::default())
            .large_file(bytes.len() > 1 << 31);
        zip.start_file(format!("{name}.npy"), options)?;
        zip.write_all(&crate::output::encode::npy::header(dtype, shape))?;
        zip.write_all(bytes)?;
    }
    Ok(zip.finish()?.into_inner())
}

#[cfg(test)]
mod tests {
    use super::super::{Detail, Format, export};
    use super::*;
    use crate::params::Params;
    use crate::render::RenderSettings;
    use crate::scene::Scene;

    /// Header and data of a member.
    fn member(bytes: &[u8], name: &str) -> (String, Vec<u8>) {
        let mut archive = zip::ZipArchive::new(Cursor::new(bytes)).expect("a zip");
        let mut file = archive.by_name(&format!("{name}.npy")).expect(name);
        let mut content = Vec::new();
        std::io::Read::read_to_end(&mut file, &mut content).expect("whole");
        let data = 10 + usize::from(u16::from_le_bytes([content[8], content[9]]));
        (String::from_utf8_lossy(&content[10..data]).into_owned(), content[data..].to_vec())
    }

    #[test]
    fn drawn_arrays_are_a_subset_of_the_authored_ones() {
        let params = Params::draw_default(7);
        let scene = Scene::build(7, &params).expect("a scene");
        let knobs = params.to_json();
        let settings = RenderSettings::new([256, 128], 4).expect("settings");
        let bytes = |detail| {
            export(&Stage { scene: &scene, seed: 7, knobs: &knobs, settings: &settings, detail }, Format::Npz)
                .expect("exported")
        };
        let (authored, drawn) = (bytes(Detail::Authored), bytes(Detail::Drawn));
        assert!(authored == bytes(Detail::Authored), "the same bytes every time");
        let rocks: usize = scene.rocks.iter().map(|rock| rock.triangles(rock.level).len()).sum();
        let count = 180_000 + rocks;
        let (header, data) = member(&authored, "triangles");
        assert!(header.contains(&format!("({count}, 3)")) && header.contains("'<u4'"), "{header}");
        let corners: Vec<u32> =
            data.chunks_exact(4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
        let (header, data) = member(&authored, "vertices");
        let vertices = data.len() / 12;
        assert!(header.contains(&format!("({vertices}, 3)")) && header.contains("'<f4'"), "{header}");
        assert_eq!(
            corners.iter().max().map(|last| *last as usize + 1),
            Some(vertices),
            "every vertex is used"
        );
        let (_, classes) = member(&authored, "triangle_class");
        assert_eq!(classes.iter().filter(|class| **class == 1).count(), rocks);
        let (_, instances) = member(&authored, "triangle_instance");
        let mut ids: Vec<u16> = instances.chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]])).collect();
        ids.dedup();
        assert_eq!(ids, (0..=scene.rocks.len() as u16).collect::<Vec<_>>());
        assert_eq!(member(&authored, "albedo").1.len(), 12 * (scene.rocks.len() + 1));
        let (header, k) = member(&authored, "K");
        assert!(
            header.contains("(3, 3)")
                && k[16..24] == 128_f64.to_le_bytes()
                && k[40..48] == 64_f64.to_le_bytes()
        );
        let positions = |bytes: &[u8]| {
            let data = member(bytes, "vertices").1;
            data.chunks_exact(12).map(<[u8]>::to_vec).collect::<std::collections::HashSet<_>>()
        };
        let (all, some) = (positions(&authored), positions(&drawn));
        assert!(some.is_subset(&all) && some.len() < all.len());
    }

    #[test]
    fn unknown_extensions_are_refused() {
        let error = Format::from_path("scene.obj".as_ref()).expect_err("no such format").to_string();
        assert!(error.contains("scene.obj") && error.contains(".npz"), "{error}");
    }
}
