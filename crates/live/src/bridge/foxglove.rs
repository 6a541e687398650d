//! The port for Foxglove and Lichtblick, which has the rules of the page's: who may connect, how many, with a token or
//! without.

use std::{io, sync::Arc};

use axum::{
    Extension, Router,
    extract::{Request, State},
    http::StatusCode,
    middleware,
    response::Response,
};

use super::{
    Bridge, Listener, accept, door,
    guests::{Peer, Role},
};
use crate::{
    page::Token,
    viewers::{self, Viewers},
};

/// Shows drives to Foxglove and Lichtblick until `shutdown` is ready. On an address that others can reach, they want
/// [a token](crate::page::Page::want_token). The bridge's own drives are among them once it was told of its
/// [viewers](Bridge::has_viewers).
///
/// # Errors
/// If there is no token.
pub async fn serve_foxglove(
    listener: Listener,
    bridge: Arc<Bridge>,
    viewers: Arc<Viewers>,
    shutdown: impl Future<Output = ()>,
) -> io::Result<()> {
    let address = listener.address().ip();
    let token = bridge.page.token_at(address).map_err(io::Error::other)?;
    let door = door::Door { bridge: bridge.clone(), bound: address, port: door::Port::Viewers };
    let app = Router::new()
        .fallback(view)
        .with_state((viewers.clone(), token))
        .layer(middleware::from_fn_with_state(door, door::ask));
    tokio::select! {
        never = accept(&listener, &app, &bridge) => match never {},
        () = shutdown => {}
    }
    viewers.end().await;
    Ok(())
}

async fn view(
    State((viewers, token)): State<(Arc<Viewers>, Option<Token>)>,
    Extension(peer): Extension<Peer>,
    request: Request,
) -> Response {
    let response = viewers::answer(viewers, token.as_ref(), request);
    if response.status() == StatusCode::SWITCHING_PROTOCOLS {
        peer.is(Role::Viewer);
    }
    response
}
