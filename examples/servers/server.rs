// A policy server in Rust: Cargo.toml needs  tungstenite = "0.24"  and  rmpv = "1".
// Then:  gn0 bench run SUITE --policy remote --policy-option url=ws://127.0.0.1:8000 --out OUT
use rmpv::{decode::read_value, encode::write_value, Value};
use std::net::{TcpListener, TcpStream};
use tungstenite::{accept, Message};

fn map(rows: Vec<(&str, Value)>) -> Value {
    Value::Map(rows.into_iter().map(|(key, value)| (key.into(), value)).collect())
}

fn get<'a>(value: &'a Value, name: &str) -> Option<&'a Value> {
    value.as_map()?.iter().find(|(key, _)| key.as_str() == Some(name)).map(|(_, held)| held)
}

fn bytes(value: &Value) -> Vec<u8> {
    let mut message = Vec::new();
    write_value(&mut message, value).expect("memory takes it");
    message
}

// {__ndarray__: true, data: bytes, dtype: "<f4", shape: [72]}
fn floats(array: &Value) -> Option<Vec<f32>> {
    if get(array, "dtype")?.as_str()? != "<f4" {
        return None;
    }
    let data = get(array, "data")?.as_slice()?;
    Some(data.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect())
}

fn answer(request: &Value, asked: &mut u32) -> Option<Value> {
    if get(request, "endpoint")?.as_str()? == "reset" {
        *asked = 0;
        return Some(map(vec![("status", "ok".into())]));
    }
    let ranges = floats(get(get(request, "gn0")?, "ranges")?)?;
    let ahead = ranges.first()?.min(*ranges.get(1)?).min(*ranges.last()?);
    *asked += 1;
    let action = if *asked > 60 { 0 } else if ahead > 0.8 { 1 } else { 2 }; // your model goes here
    let actions = Value::Array(vec![action.into()]);
    Some(map(vec![("action_type", "discrete".into()), ("actions", actions)]))
}

fn serve(stream: TcpStream) -> Result<(), Box<dyn std::error::Error>> {
    stream.set_nodelay(true)?;
    let mut socket = accept(stream)?;
    let wants = Value::Array(vec!["ranges".into()]);
    let about = map(vec![
        ("version", 1.into()),
        ("name", "rust".into()),
        ("keys", "text".into()),
        ("wants", wants),
    ]);
    socket.send(Message::Binary(bytes(&map(vec![("gn0", about)])).into()))?;
    let mut asked = 0;
    loop {
        if let Message::Binary(frame) = socket.read()? {
            let request = read_value(&mut &frame[..])?;
            match answer(&request, &mut asked) {
                Some(reply) => socket.send(Message::Binary(bytes(&reply).into()))?,
                None => socket.send(Message::Text("this is no request".into()))?,
            }
        }
    }
}

fn main() -> std::io::Result<()> {
    let port = std::env::args().nth(1).unwrap_or("8000".into());
    let door = TcpListener::bind(format!("127.0.0.1:{port}"))?;
    println!("ws://{}", door.local_addr()?);
    for stream in door.incoming().flatten() {
        std::thread::spawn(move || serve(stream).unwrap_or_else(|error| eprintln!("{error}")));
    }
    Ok(())
}
