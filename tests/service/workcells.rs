//! Workcells that are registered once and referred to from then on.

use std::io::Write;

use flate2::Compression;
use flate2::write::GzEncoder;
use serde_json::{Value, json};

use crate::script::problem;
use crate::server::{Server, problem_document};

fn cell() -> Value {
    problem("x")["workcell"].take()
}

/// The cell with its robot as a file of the bundle, and an obstacle that is a mesh, far from all.
fn cell_with_files() -> (Value, Vec<(&'static str, Vec<u8>)>) {
    let robot = quadrille::kinematics::library("iiwa14").unwrap();
    let mut document = cell();
    document["robots"] = json!({"iiwa14": {"urdf": "robots/arm.urdf", "srdf": "robots/arm.srdf"}});
    document["obstacles"].as_array_mut().unwrap().push(json!({
        "id": "statue", "shape": {"type": "mesh", "uri": "meshes/statue.stl"},
        "pose": {"position": {"x": 5.0, "y": 5.0, "z": 0.0}},
    }));
    let mut stl = vec![0_u8; 80];
    let corners = [[0.0_f32, 0.0, 0.0], [0.2, 0.0, 0.0], [0.0, 0.2, 0.0], [0.0, 0.0, 0.2]];
    stl.extend(4_u32.to_le_bytes());
    for face in [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]] {
        stl.extend([0_u8; 12]);
        stl.extend(face.iter().flat_map(|corner: &usize| corners[*corner]).flat_map(f32::to_le_bytes));
        stl.extend([0_u8; 2]);
    }
    let files = vec![
        ("robots/arm.urdf", robot.urdf.as_bytes().to_vec()),
        ("robots/arm.srdf", robot.srdf.as_bytes().to_vec()),
        ("meshes/statue.stl", stl),
    ];
    (document, files)
}

fn tar_gz(document: &Value, files: &[(&str, Vec<u8>)]) -> Vec<u8> {
    let mut builder = tar::Builder::new(GzEncoder::new(Vec::new(), Compression::fast()));
    let text = document.to_string().into_bytes();
    for (path, content) in std::iter::once(&("workcell.json", text)).chain(files) {
        let mut header = tar::Header::new_gnu();
        header.set_size(content.len() as u64);
        header.set_mode(0o644);
        builder.append_data(&mut header, path, content.as_slice()).unwrap();
    }
    let mut encoder = builder.into_inner().unwrap();
    encoder.flush().unwrap();
    encoder.finish().unwrap()
}

async fn put(server: &Server, id: &str, media: &str, body: impl Into<reqwest::Body>) -> reqwest::Response {
    let request = server.client.put(server.url(&format!("/v1/workcells/{id}"))).header("content-type", media);
    request.body(body).send().await.unwrap()
}

#[tokio::test]
async fn jobs_refer_to_a_workcell_by_id_and_by_digest() {
    let server = Server::start(1, 8).await;
    let reply = put(&server, "cell", "application/json", cell().to_string()).await;
    assert_eq!(
        (reply.status().as_u16(), &reply.headers()["location"]),
        (201, &"/v1/workcells/cell".parse().unwrap())
    );
    let entry: Value = reply.json().await.unwrap();
    let digest = entry["digest"].as_str().unwrap().to_owned();
    let whole: Value =
        server.post("/v1/validate", problem("improve 1").to_string()).await.json().await.unwrap();
    for reference in ["cell", &digest] {
        let mut referring = problem("improve 1");
        referring["workcell"] = json!(reference);
        let read: Value = server.post("/v1/validate", referring.to_string()).await.json().await.unwrap();
        assert_eq!(
            read["problem_digest"], whole["problem_digest"],
            "the reference counts by what it leads to"
        );
        let reply = server.post("/v1/plan", referring.to_string()).await;
        assert_eq!(reply.status(), 200);
        assert!(reply.text().await.unwrap().contains("\"SUCCEEDED\""));
    }
    // The same again changes nothing; another one is another version, and the first one stays.
    assert_eq!(put(&server, "cell", "application/json", cell().to_string()).await.status(), 200);
    let mut other = cell();
    other["arms"][0]["tool"]["max_opening"] = json!(0.09);
    let replaced: Value =
        put(&server, "cell", "application/json", other.to_string()).await.json().await.unwrap();
    assert_ne!(replaced["digest"], json!(digest));
    assert_eq!(server.json(&format!("/v1/workcells/{digest}")).await["workcell"], cell());
    assert_eq!(server.json("/v1/workcells/cell").await["workcell"], other);
    let listed = server.json("/v1/workcells").await;
    assert_eq!(listed["workcells"].as_array().unwrap().len(), 1);

    let mut nowhere = problem("improve 1");
    nowhere["workcell"] = json!("nowhere");
    let reply = server.post("/v1/jobs", json!({"problem": nowhere}).to_string()).await;
    let document = problem_document(reply).await;
    assert_eq!(document["errors"][0]["pointer"], "/problem/workcell");
    assert_eq!(server.get("/v1/workcells/nowhere").await.status(), 404);
}

#[tokio::test]
async fn a_bundle_brings_its_files() {
    let server = Server::start(1, 8).await;
    let (document, files) = cell_with_files();
    let archive = tar_gz(&document, &files);
    let reply = put(&server, "bundle", "application/gzip", archive).await;
    assert_eq!(reply.status(), 201, "{}", reply.text().await.unwrap());
    let found = server.json("/v1/workcells/bundle").await;
    let paths: Vec<&str> =
        found["files"].as_array().unwrap().iter().filter_map(|file| file["path"].as_str()).collect();
    assert_eq!(paths, ["meshes/statue.stl", "robots/arm.srdf", "robots/arm.urdf"]);
    let mut referring = problem("improve 1");
    referring["workcell"] = json!("bundle");
    let reply = server.post("/v1/plan", referring.to_string()).await;
    assert!(reply.text().await.unwrap().contains("\"SUCCEEDED\""));

    // A file that is missing, one that leads outside, and none at all.
    let without = put(&server, "b", "application/gzip", tar_gz(&document, &files[..2])).await;
    assert_eq!(without.status(), 422);
    assert_eq!(problem_document(without).await["errors"][0]["code"], "unresolved_uri");
    let mut outside = document.clone();
    outside["robots"]["iiwa14"]["urdf"] = json!("../robots/arm.urdf");
    let outside = put(&server, "b", "application/gzip", tar_gz(&outside, &files)).await;
    assert_eq!(problem_document(outside).await["errors"][0]["code"], "unresolved_uri");
    for (media, body) in [("application/zip", b"PK".to_vec()), ("application/gzip", tar_gz(&json!(1), &[]))] {
        assert_eq!(put(&server, "b", media, body).await.status(), 422);
    }
    let alone = put(&server, "b", "application/json", document.to_string()).await;
    assert_eq!(problem_document(alone).await["errors"][0]["code"], "unresolved_uri");
    assert_eq!(put(&server, "b", "text/plain", "x").await.status(), 415);
    for id in ["...", "a%20b", &"x".repeat(65)] {
        let reply = put(&server, id, "application/json", cell().to_string()).await;
        assert_eq!(problem_document(reply).await["code"], "bad_parameter", "{id}");
    }
}

#[tokio::test]
async fn a_workcell_survives_the_process_with_the_jobs_that_refer_to_it() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::keeping(folder.path()).await;
    let (document, files) = cell_with_files();
    put(&server, "bundle", "application/gzip", tar_gz(&document, &files)).await;
    let blocking = server.create("wait").await;
    server.until(&blocking, "incumbent").await;
    let mut referring = problem("improve 2");
    referring["workcell"] = json!("bundle");
    let reply = server.post("/v1/jobs", referring.to_string()).await;
    let job = reply.headers()["location"].to_str().unwrap().to_owned();
    // The job keeps the version that it came with.
    put(&server, "bundle", "application/json", cell().to_string()).await;
    server.client.delete(server.url("/v1/workcells/bundle")).send().await.unwrap();
    server.stop().await;

    let server = Server::keeping(folder.path()).await;
    server.post(&format!("{blocking}/cancel"), "").await;
    assert_eq!(server.durable(&job).await.last().unwrap()["state"], "SUCCEEDED");
    assert_eq!(server.get("/v1/workcells/bundle").await.status(), 404);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_workcell_has_a_mode_graph() {
    let server = Server::start(1, 8).await;
    put(&server, "cell", "application/json", cell().to_string()).await;
    let graph = server.json("/v1/workcells/cell/modes").await;
    assert_eq!((&graph["schema"], &graph["complete"]), (&json!("quadrille.mode_graph/1"), &json!(true)));
    let kinds: Vec<&str> =
        graph["nodes"].as_array().unwrap().iter().filter_map(|node| node["place"]["kind"].as_str()).collect();
    assert_eq!(kinds.iter().filter(|kind| **kind == "arm").count(), 2);
    assert!(kinds.contains(&"region") && !graph["edges"].as_array().unwrap().is_empty());
    assert_eq!(server.json("/v1/workcells/cell/modes?size=0.06,0.06,0.06").await, graph);
    for (query, status) in [("?size=1", 400), ("?size=9,9,9", 422), ("?colour=red", 400)] {
        assert_eq!(server.get(&format!("/v1/workcells/cell/modes{query}")).await.status(), status, "{query}");
    }
    assert_eq!(server.get("/v1/workcells/nowhere/modes").await.status(), 404);
}

/// Where the arms of a workcell start is a problem's business.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn arms_of_a_workcell_need_no_home_that_they_could_be_at() {
    let server = Server::start(1, 8).await;
    let mut bent = cell();
    bent["robots"]["iiwa14"]["limits"] = json!({"joint_4": {"upper": -0.1}});
    let mut starts = json!({});
    for arm in bent["arms"].as_array_mut().unwrap() {
        let home = arm.as_object_mut().unwrap().remove("home").unwrap();
        starts[arm["id"].as_str().unwrap()] = home;
    }
    let reply = put(&server, "bent", "application/json", bent.to_string()).await;
    assert_eq!(reply.status(), 201, "{}", reply.text().await.unwrap());
    let graph = server.json("/v1/workcells/bent/modes").await;
    assert_eq!(graph["schema"], "quadrille.mode_graph/1");
    let mut referring = problem("improve 1");
    referring["workcell"] = json!("bent");
    let nowhere = problem_document(server.post("/v1/validate", referring.to_string()).await).await;
    assert_eq!(nowhere["errors"][0]["code"], "out_of_range");
    referring["initial_joints"] = starts;
    assert_eq!(server.post("/v1/validate", referring.to_string()).await.status(), 200);
    // What a workcell says of home itself has to be right.
    bent["arms"][0]["home"] = json!({"joint_4": 0.0});
    let wrong = problem_document(put(&server, "wrong", "application/json", bent.to_string()).await).await;
    assert_eq!(wrong["errors"][0]["pointer"], "/arms/0/home/joint_4");
}
