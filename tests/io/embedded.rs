//! Files of a mesh that a cloth carries along.

use super::{GRID, waving};
use fnopt::cloth::Embedding;
use fnopt::io::{Embedded, Format, Frames, RenderMesh, Trajectory, write, write_mesh};
use serde_json::Value;
use std::{fs, path::Path};

/// A quad, a pentagon and a triangle, with a seam between the first two.
const MESH: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 2 0 0\nv 3 0.5 0\nv 2 1 0\nv 1 2 0\n\
    vt 0.1 0.1\nvt 0.4 0.1\nvt 0.4 0.6\nvt 0.1 0.6\nvt 0.5 0.1\nvt 0.8 0.1\nvt 1 0.35\nvt 0.8 0.6\nvt 0.5 0.6\nvt 0.3 1\n\
    f 1/1 2/2 3/3 4/4\nf 2/5 5/6 6/7 7/8 3/9\nf 4/4 3/3 8/10\n";
const VERTICES: usize = 10;

fn read(folder: &Path) -> (RenderMesh, Embedding) {
    fs::write(folder.join("mesh.obj"), MESH).unwrap();
    let mesh = RenderMesh::read(folder.join("mesh.obj")).unwrap();
    let embedding = Embedding::new(GRID, None, mesh.topology().uv(), "mesh.obj").unwrap();
    (mesh, embedding)
}

#[test]
fn every_format_has_the_vertices_and_the_polygons_of_the_mesh() {
    let folder = tempfile::tempdir().unwrap();
    let (mesh, embedding) = read(folder.path());
    let cloth = waving(GRID, 3);
    let frames = Embedded::new(&cloth, mesh.topology(), &embedding);
    assert_eq!((frames.frames(), frames.fps(), mesh.topology().vertices()), (3, 60.0, VERTICES));
    for frame in 0..3 {
        assert_eq!(*frames.positions_of(frame).unwrap(), embedding.positions(cloth.frame(frame)));
        assert_eq!(*frames.velocities_of(frame).unwrap(), embedding.positions(cloth.frame_velocities(frame)));
    }
    let file = |format: Format| write(&frames, folder.path(), "cloth", format, &Default::default()).unwrap();
    let points = |frame: usize| embedding.positions(cloth.frame(frame));

    // What was written is the same mesh.
    let obj = file(Format::Obj);
    let again = RenderMesh::read(obj.join("00002.obj")).unwrap();
    assert_eq!((again.topology(), again.positions()), (mesh.topology(), &points(2)[..]));
    assert_eq!(mesh.topology().counts(), [4, 5, 3]);

    let ply = fs::read(file(Format::Ply).join("00001.ply")).unwrap();
    let header = String::from_utf8_lossy(&ply[..300]).into_owned();
    assert!(header.contains("element vertex 10\n") && header.contains("element face 3\n"), "{header}");
    let body = ply.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
    let first: Vec<f32> =
        ply[body..body + 12].chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect();
    assert_eq!(first, points(1)[0]);
    assert_eq!(ply.len(), body + 24 * VERTICES + 3 + 4 * 12);

    let usd = fs::read_to_string(file(Format::Usda)).unwrap();
    assert!(usd.contains("faceVertexCounts = [4, 5, 3]"));
    let corners: Vec<String> = mesh.topology().corners().iter().map(u32::to_string).collect();
    assert!(usd.contains(&format!("faceVertexIndices = [{}]", corners.join(", "))));
    let [u, v] = mesh.topology().uv()[0];
    assert!(usd.contains(&format!("primvars:st = [({u}, {v}), ")));

    let glb = fs::read(file(Format::Glb)).unwrap();
    let text = u32::from_le_bytes(glb[12..16].try_into().unwrap()) as usize;
    let document: Value = serde_json::from_slice(&glb[20..20 + text]).unwrap();
    let primitive = &document["meshes"][0]["primitives"][0];
    let accessor = |index: &Value| &document["accessors"][index.as_u64().unwrap() as usize];
    // A fan of 2 + 3 + 1 triangles.
    assert_eq!(accessor(&primitive["indices"])["count"], 18);
    for name in ["POSITION", "NORMAL", "TEXCOORD_0"] {
        assert_eq!(accessor(&primitive["attributes"][name])["count"], VERTICES, "{name}");
    }
    assert_eq!(primitive["targets"].as_array().unwrap().len(), 2);

    for format in [Format::Pc2, Format::Mdd] {
        let cache = Trajectory::read(file(format), &Default::default());
        // Its vertices are no grid, which a trajectory must be.
        assert!(cache.is_err() || cache.unwrap().positions().shape() == [3, VERTICES, 3]);
        let bytes = fs::metadata(folder.path().join(format!("cloth.{format}"))).unwrap().len() as usize;
        let header = if format == Format::Pc2 { 32 } else { 8 + 4 * 3 };
        assert_eq!(bytes, header + 3 * VERTICES * 12, "{format}");
    }
    write_mesh(&frames, folder.path().join("still.obj")).unwrap();
    let still = RenderMesh::read(folder.path().join("still.obj")).unwrap();
    assert_eq!((still.topology(), still.positions()), (mesh.topology(), &points(0)[..]));
}
