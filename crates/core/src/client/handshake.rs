//! The WebSocket handshake as the stock simulator does it, and the answers that it refuses.

use std::{
    io::{self, Read, Write},
    net::{TcpStream, ToSocketAddrs},
    time::Duration,
};

use tungstenite::{
    WebSocket,
    handshake::{client::generate_key, derive_accept_key},
    protocol::Role,
};

use super::ClientError;

/// Dials as websocket-sharp does, Nagle on.
pub(super) fn connect(address: &str) -> Result<WebSocket<TcpStream>, ClientError> {
    let error = |source| ClientError::Connect { address: address.to_owned(), source };
    let mut addresses = address.to_socket_addrs().map_err(error)?;
    let mut stream = loop {
        let Some(address) = addresses.next() else { return Err(error(io::ErrorKind::AddrNotAvailable.into())) };
        match TcpStream::connect_timeout(&address, Duration::from_secs(10)) {
            Ok(stream) => break stream,
            Err(e) if addresses.len() == 0 => return Err(error(e)),
            Err(_) => {}
        }
    };
    stream.set_nodelay(false).map_err(error)?;
    stream.set_read_timeout(Some(Duration::from_secs(10))).map_err(error)?;
    let key = generate_key();
    let request = format!(
        "GET /socket.io/?EIO=4&transport=websocket HTTP/1.1\r\nUser-Agent: websocket-sharp/1.0\r\nUpgrade: websocket\r\n\
         Connection: Upgrade\r\nHost: {address}\r\nSec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n\r\n"
    );
    stream.write_all(request.as_bytes()).map_err(error)?;
    let (head, rest) = read_head(&mut stream).map_err(error)?;
    let refused = |expected, got: &str| Err(ClientError::Handshake { expected, got: got.chars().take(200).collect() });
    let mut lines = head.lines();
    let status = lines.next().unwrap_or("");
    if !status.contains(" 101 ") {
        return refused("HTTP/1.1 101 Switching Protocols", status);
    }
    let mut accepted = false;
    for (name, value) in lines.filter_map(|l| l.split_once(':')) {
        match name.to_ascii_lowercase().as_str() {
            "sec-websocket-extensions" => return refused("no WebSocket extension", value.trim()),
            "sec-websocket-accept" => accepted = value.trim() == derive_accept_key(key.as_bytes()),
            _ => {}
        }
    }
    if !accepted {
        return refused("the Sec-WebSocket-Accept that belongs to the key", &head);
    }
    Ok(WebSocket::from_partially_read(stream, rest, Role::Client, None))
}

/// Reads up to the end of a response head; anything after it is returned separately.
fn read_head(stream: &mut TcpStream) -> io::Result<(String, Vec<u8>)> {
    const LONGEST: usize = 16 << 10;
    let mut bytes = Vec::new();
    let mut chunk = [0; 2048];
    loop {
        if let Some(end) = bytes.windows(4).position(|w| w == b"\r\n\r\n") {
            let rest = bytes.split_off(end + 4);
            return Ok((String::from_utf8_lossy(&bytes).into_owned(), rest));
        }
        match stream.read(&mut chunk)? {
            0 => return Err(io::Error::new(io::ErrorKind::UnexpectedEof, "closed during the handshake")),
            _ if bytes.len() > LONGEST => return Err(io::Error::other("an endless response head")),
            n => bytes.extend_from_slice(&chunk[..n]),
        }
    }
}
